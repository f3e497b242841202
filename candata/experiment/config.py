"""The file of an experiment: where data come from, which models are trained on them and how, and how they score."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from candata.errors import UnknownNameError, UsageError, Where
from candata.gap.blind.outside_causes import CAUSES
from candata.models import MODELS
from candata.scenes.object_folder import listed_objects
from candata.schema.record import Record
from candata.schema.yaml_text import read_yaml
from candata.simulate.recipe import SetRecipe, Words

Regime = Literal["sim", "real", "real-finetune"]
Origin = Literal["nominal", "repaired"]
SimulatedRow = Literal["stays", "keeps_velocity", "simulator", "repaired simulator"]
Count = Annotated[int, Field(ge=1)]
#: Fewest steps of a training run, episodes of a simulated set and training episodes of a real one, whatever the scale.
#: Chosen: fewer train nothing, and real episodes are few anyway.
LEAST_STEPS, LEAST_EPISODES, LEAST_REAL = 20, 12, 30


#: Fields of a set that name files.
FILES = ("effects", "randomise", "policy_file", "hidden", "noise_from")


class SealedWorld(Record):
    """A simulated world that stands in for the real one; what differs in it is sealed until the table is written.

    One of `hidden` (a file as for `--randomise`, of which one draw acts in all episodes), `outside` (a cause that no
    effect of the library is) and `all_wrong` (every parameter about 5 % off). Worlds of one name share their draw.
    `train` and `test` count episodes; `noise_from` is a file of sensor noise, such as a slow tracker's.
    """

    scene: str
    world: str | None = None
    hidden: str | None = None
    outside: str | None = None
    all_wrong: bool = False
    objects: Words = ()
    policies: Words = ()
    duration_s: float = Field(default=3.2, gt=0)
    seed: int = Field(default=1000, ge=0)
    noise_from: str | None = None
    train: Count
    test: Count

    @model_validator(mode="after")
    def _differs_in_one_way(self) -> Self:
        """Refuse none of the three, or several; outside causes play with the scene's own object and motions."""
        if sum((self.hidden is not None, self.outside is not None, self.all_wrong)) != 1:
            raise ValueError("expected one of hidden, outside and all_wrong")
        if self.hidden is None and (self.objects or self.policies):
            raise ValueError("objects and policies go with hidden alone; name the object in the scene, as SCENE+OBJECT")
        return self


class Source(Record):
    """A dataset: one that stands (`path`), one to simulate (`recipe`, `generate`), or a world that stands in for real.

    `split` and `cloud_of` are of a `path` alone: the stored split whose `test` is held out (default: the default one),
    and the scene whose object's surface the episodes get as point cloud, where they have none.
    """

    path: str | None = None
    split: str | None = None
    cloud_of: str | None = None
    recipe: str | None = None
    generate: SetRecipe | None = None
    sealed: SealedWorld | None = None

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        """Refuse none of them, or several."""
        if sum(value is not None for value in (self.path, self.recipe, self.generate, self.sealed)) != 1:
            raise ValueError("expected one of path, recipe, generate and sealed")
        if (self.split is not None or self.cloud_of is not None) and self.path is None:
            raise ValueError("split and cloud_of go with path alone")
        return self


class Column(Record):
    """A column of the table, or a case: names of `data`.

    `sim` is pre-trained on and `larger` fine-tuned on, at a lower rate; `real` is co-trained on and tested on. The
    repair is diagnosed from the training part of `diagnosed` (default: `real`) in `scene`; simulators play in it too,
    or, where it is left out, in the scene that each episode names.
    """

    sim: str | None = None
    larger: str | None = None
    real: str
    diagnosed: str | None = None
    scene: str | None = None


class ModelEntry(Record):
    """A model of the table: registered name (default: the key), preset and what of its configuration differs.

    `steps` are those of pre-training and of training on real episodes, `fine_tune_steps` (default: `steps`) those of
    fine-tuning and of co-training, at `fine_tune_rate` (default: a tenth of `learning_rate`). `origins` are those of
    the experiment where they are left out.
    """

    model: str | None = None
    preset: str = "small"
    config: dict[str, Any] = Field(default_factory=dict)
    steps: Count = 3000
    fine_tune_steps: Count | None = None
    batch: Count = 64
    learning_rate: float = Field(1e-4, gt=0, lt=1)
    fine_tune_rate: float | None = Field(default=None, gt=0, lt=1)
    origins: tuple[Origin, ...] | None = Field(default=None, min_length=1)


class WindowShape(Record):
    """Rows of the past, steps of the future, and steps a second."""

    history: Count = 8
    horizon: Count = 16
    rate_hz: float = Field(default=10.0, gt=0)


class Scoring(Record):
    """Samples of a forecast, steps of the sampler, steps done before the next forecast, and the seed of the noise."""

    samples: Count = 16
    steps: Count = 10
    execute: Count | None = None
    seed: int = Field(default=0, ge=0)


class DiagnosisPlan(Record):
    """How the repair is sought: CPU seconds it may take, and effects to search among (default: all)."""

    budget_s: float | None = Field(default=3600.0, gt=0)
    only: Words = ()
    seed: int = Field(default=0, ge=0)


class ExperimentFile(Record):
    """The file of an experiment, paths seen from its folder.

    `origins` are the simulations that models are pre-trained on: `nominal`, and `repaired` by the diagnosis.
    `real_counts` are numbers of real training episodes (0: none); without any, all of them. `mixture` are the shares of
    co-training. `main` is the model that the first line speaks of, `without_contact` what it is compared with.
    `intervals` of the table are of so many resamples.
    """

    title: str
    data: dict[str, Source] = Field(min_length=1)
    columns: dict[str, Column] = Field(min_length=1)
    models: dict[str, ModelEntry] = Field(min_length=1)
    regimes: tuple[Regime, ...] = Field(default=("sim", "real", "real-finetune"), min_length=1)
    origins: tuple[Origin, ...] = Field(default=("nominal",), min_length=1)
    real_counts: tuple[Annotated[int, Field(ge=0)], ...] = ()
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = Field(default=(0, 1, 2), min_length=1)
    rows: tuple[SimulatedRow, ...] = ("stays", "simulator", "repaired simulator")
    mixture: dict[Literal["sim", "real"], float] = Field(default={"sim": 0.5, "real": 0.5})
    windows: WindowShape = WindowShape()
    evaluation: Scoring = Scoring()
    diagnosis: DiagnosisPlan = DiagnosisPlan()
    main: str | None = None
    without_contact: str | None = None
    notes: Words = ()

    @field_validator("mixture")
    @classmethod
    def _has_both(cls, mixture: dict[str, float]) -> dict[str, float]:
        """Refuse shares of one alone, and shares that are not above zero."""
        if set(mixture) != {"sim", "real"} or min(mixture.values()) <= 0:
            raise ValueError("expected shares of sim and real, both above 0")
        return mixture

    @property
    def main_model(self) -> str:
        """The model of the first line: `main`, else the last one."""
        return self.main or list(self.models)[-1]

    @property
    def counts(self) -> tuple[int | None, ...]:
        """Numbers of real training episodes above zero, in rising order; None for all."""
        return tuple(sorted({count for count in self.real_counts if count})) or (None,)


def read_experiment(path: Path, scale: float = 1.0) -> ExperimentFile:
    """Return the experiment of a file: paths made absolute, names checked, episodes and steps scaled.

    Parameters
    ----------
    path : Path
        YAML file.
    scale : float
        Factor on episodes and steps, above 0 and at most 1; numbers of real episodes become at most those left.

    Raises
    ------
    UsageError
        When it is missing or not valid, names what is not there, or the scale is out of range.
    """
    if not 0 < scale <= 1:
        raise UsageError("--scale is out of range", expected="above 0, at most 1", found=f"{scale:g}")
    file = ExperimentFile.parse(read_yaml(path, "the experiment"), path)
    file = file.model_copy(
        update={
            "data": {name: _located(each, path.parent) for name, each in file.data.items()},
            "columns": {
                title: column.model_copy(update={"scene": column.scene and _scene_beside(column.scene, path.parent)})
                for title, column in file.columns.items()
            },
        }
    )
    _check_names(file, path)
    file = _scaled(file, scale) if scale < 1 else file
    most = min((world.train for source in file.data.values() if (world := source.sealed)), default=None)
    if most is None:
        return file
    if scale == 1 and max(file.real_counts, default=0) > most:
        raise UsageError(
            "real_counts asks for more real training episodes than a world has",
            expected=f"at most {most}",
            found=str(max(file.real_counts)),
            where=Where(path=str(path)),
            fix="raise `train` of the sealed worlds",
        )
    return file.model_copy(update={"real_counts": tuple(dict.fromkeys(min(n, most) for n in file.real_counts))})


def _located(source: Source, folder: Path) -> Source:
    """Return a source with its recipe read, and its paths seen from the folder of the file that names them."""
    if source.path is not None:
        cloud_of = source.cloud_of and _scene_beside(source.cloud_of, folder)
        return source.model_copy(update={"path": _beside(source.path, folder), "cloud_of": cloud_of})
    if source.sealed is not None:
        return Source(sealed=_with_paths(source.sealed, folder))
    if source.generate is not None:
        return Source(generate=_with_paths(source.generate, folder))
    file = Path(_beside(str(source.recipe), folder))
    return Source(generate=_with_paths(SetRecipe.parse(read_yaml(file, "the recipe"), file), file.parent))


def _with_paths(record: Any, folder: Path) -> Any:
    """Return a set's record with absolute paths, and a file of objects replaced by what it lists."""
    changes: dict[str, Any] = {"scene": _scene_beside(record.scene, folder)}
    for name in FILES:
        if getattr(record, name, None) is not None:
            changes[name] = _beside(getattr(record, name), folder)
            if not Path(changes[name]).is_file():
                raise UsageError(f"the file of `{name}` is not there", where=Where(path=changes[name]))
    if len(record.objects) == 1 and record.objects[0].endswith((".yaml", ".yml")):
        changes["objects"] = listed_objects(Path(_beside(record.objects[0], folder)))
    else:
        changes["objects"] = tuple(_object_beside(name, folder) for name in record.objects)
    return record.model_copy(update=changes)


def _beside(text: str, folder: Path) -> str:
    """Return a path as seen from a folder, absolute."""
    return str((folder / text).resolve())


def _object_beside(name: str, folder: Path) -> str:
    """Return an object's folder, absolute; a registered object's name as it is."""
    return _beside(name, folder) if "/" in name else name


def _scene_beside(scene: str, folder: Path) -> str:
    """Return a scene's file as an absolute path, a built-in scene's name as it is; the object after `+` alike."""
    base, plus, object_name = scene.partition("+")
    located = _beside(base, folder) if base.endswith((".yaml", ".yml")) else base
    return f"{located}{plus}{_object_beside(object_name, folder) if plus else ''}"


def _check_names(file: ExperimentFile, path: Path) -> None:
    """Refuse names of data, models and causes that are not there, and columns that lack what their regimes need."""
    where = Where(path=str(path))
    for title, column in file.columns.items():
        for name in filter(None, (column.sim, column.larger, column.real, column.diagnosed)):
            _require(f"source of data in column {title}", name, file.data, where)
        needs_sim = {"sim", "real-finetune"} & set(file.regimes)
        if needs_sim and column.sim is None:
            raise UsageError(
                f"column {title} has no simulated set",
                expected=f"sim: NAME, for the regime {sorted(needs_sim)[0]}",
                where=where,
                fix="name one, or leave out these regimes",
            )
        for role, simulated in (("sim", column.sim), ("larger", column.larger)):
            if simulated is not None and file.data[simulated].sealed is not None:
                raise UsageError(
                    f"column {title}: {role} {simulated} is a sealed world", where=where, fix="swap the names"
                )
        if file.data[column.real].generate is not None:
            raise UsageError(
                f"column {title}: real {column.real} is a simulated set without a seal",
                expected="path or sealed",
                where=where,
            )
        _refuse_shared_episodes(file, title, column, where)
    for name, entry in file.models.items():
        _require("model", entry.model or name, MODELS.names(), where)
    for name in filter(None, (file.main, file.without_contact)):
        _require("model of the experiment", name, file.models, where)
    for name, source in file.data.items():
        if source.sealed is not None and source.sealed.outside is not None:
            _require("outside cause", source.sealed.outside, CAUSES, where)
        made, span_s = source.sealed or source.generate, file.windows.horizon / file.windows.rate_hz
        if made is not None and made.duration_s < span_s:
            raise UsageError(
                f"the episodes of {name} are shorter than the horizon",
                expected=f"duration_s of at least {span_s:g}, as `windows` says",
                found=f"{made.duration_s:g}",
                where=where,
                fix="lengthen them, or shorten the horizon",
            )


def _refuse_shared_episodes(file: ExperimentFile, title: str, column: Column, where: Where) -> None:
    """Refuse to diagnose episodes of a sealed world that are test episodes of the same world with fewer to train on."""
    real = file.data[column.real].sealed
    diagnosed = file.data[column.diagnosed or column.real].sealed
    if real is None or diagnosed is None or diagnosed.train <= real.train:
        return
    if diagnosed.model_copy(update={"train": real.train, "test": real.test}) == real:
        raise UsageError(
            f"column {title}: training episodes of {column.diagnosed} are test episodes of {column.real}",
            expected=f"at most {real.train} of them, or another seed",
            found=str(diagnosed.train),
            where=where,
        )


def _require(kind: str, name: str, known_names: Iterable[str] | Mapping[str, Any], where: Where) -> None:
    """Refuse a name that is not among the known ones."""
    known_list = list(known_names)
    if name not in known_list:
        raise UnknownNameError(kind, name, known_list, where)


def _scaled(file: ExperimentFile, scale: float) -> ExperimentFile:
    """Return the experiment with fewer episodes and steps; test episodes stay, as intervals hang on their number."""

    def fewer(count: int, least: int) -> int:
        return max(min(count, least), round(scale * count))

    def smaller(source: Source) -> Source:
        if source.generate is not None:
            count = fewer(source.generate.episodes, LEAST_EPISODES)
            return Source(generate=source.generate.model_copy(update={"episodes": count}))
        if source.sealed is not None:
            count = fewer(source.sealed.train, LEAST_REAL)
            return Source(sealed=source.sealed.model_copy(update={"train": count}))
        return source

    def shorter(entry: ModelEntry) -> ModelEntry:
        tuned = None if entry.fine_tune_steps is None else fewer(entry.fine_tune_steps, LEAST_STEPS)
        return entry.model_copy(update={"steps": fewer(entry.steps, LEAST_STEPS), "fine_tune_steps": tuned})

    return file.model_copy(
        update={
            "data": {name: smaller(source) for name, source in file.data.items()},
            "models": {name: shorter(entry) for name, entry in file.models.items()},
        }
    )
