"""What the cells do: each makes its part in a folder of its own, and goes on where an earlier run was stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from candata.datasets import Dataset, open_dataset
from candata.datasets.durable import ensure_folder
from candata.datasets.writing import write_text
from candata.effects import read_effects
from candata.errors import CandataError
from candata.experiment import sources
from candata.experiment.cells import (
    EFFECTS,
    EVALUATION,
    RUN,
    SETS,
    Cell,
    CellRecord,
    cell_folder,
    drop_outdated,
    made_from,
    read_cell,
    versions,
    write_cell,
)
from candata.experiment.config import SealedWorld
from candata.gap import Diagnosis, diagnose
from candata.loaders import parse_mixture
from candata.models import model as find_model
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.schema.json_text import parse_json
from candata.simulate.recipe import SetRecipe
from candata.training.evaluation import EvaluationSettings, evaluate
from candata.training.jobs import TrainRequest, prepare
from candata.training.loop import train
from candata.training.results import REPAIRED, SIMULATOR
from candata.training.settings import TrainingSettings

SEALS = "seals"
#: Fewest validations of a run. Chosen: a best checkpoint needs something to be best of.
VALIDATIONS = 4

WriteDiagnosis = Callable[[Diagnosis, Scene, Path], object]


@dataclass(frozen=True)
class Failure:
    """A cell that failed, or could not begin because another one did."""

    name: str
    reason: str


@dataclass(frozen=True)
class Bench:
    """Where and with what cells are made.

    Attributes
    ----------
    out : Path
        Folder of the experiment.
    jobs : int
        Processes, or threads of a diagnosis.
    ray : str or None
        Address of a Ray cluster for simulated sets.
    write_diagnosis : callable
        Writes the files of a diagnosis into a folder, `effects.yaml` among them.
    stage : callable
        Hears what is being done.
    cache : Path or None
        Where diagnoses keep what they simulated.
    """

    out: Path
    jobs: int
    ray: str | None
    write_diagnosis: WriteDiagnosis
    stage: Callable[[str], None]
    cache: Path | None


def make_set(cell: Cell, digest: str, inputs: Mapping[str, Path], bench: Bench) -> CellRecord | Failure:
    """Return the record of a set, a part or a diagnosis once it stands; one that fails is told, not raised."""
    makers = {"data": _make_data, "part": _make_part, "diagnosis": _make_diagnosis}
    maker = makers[cell.kind]
    return _recorded(cell, digest, bench.out, inputs, lambda folder: maker(cell, folder, inputs, bench))


def run_cell(out: str, cell: Cell, digest: str, inputs: dict[str, str], threads: int) -> CellRecord | Failure:
    """Return the record of a run or an evaluation once it stands; runs in any process or on any machine.

    Parameters
    ----------
    out : str
        Folder of the experiment.
    cell : Cell
        What is made.
    digest : str
        Its digest.
    inputs : dict of str to str
        Folder of each input, by role.
    threads : int
        Threads of torch.
    """
    import torch

    torch.set_num_threads(threads)
    maker = {"train": _make_run, "evaluation": _make_evaluation}[cell.kind]
    paths = {role: Path(path) for role, path in inputs.items()}
    return _recorded(cell, digest, Path(out), paths, lambda folder: maker(cell, folder, paths, threads))


def _recorded(
    cell: Cell, digest: str, out: Path, inputs: Mapping[str, Path], make: Callable[[Path], dict[str, Any]]
) -> CellRecord | Failure:
    """Return the record of a cell, written last; or why it failed: no cell takes others with it."""
    folder = cell_folder(out, cell, digest)
    standing = read_cell(folder, digest, inputs)
    if standing is not None:
        return standing
    begin_s = time.monotonic()
    try:
        drop_outdated(folder, inputs)
        result = make(ensure_folder(folder))
        record = CellRecord(
            name=cell.name,
            kind=cell.kind,
            digest=digest,
            settings=dict(cell.settings),
            inputs=dict(cell.inputs),
            made_from=made_from(inputs),
            versions=versions(cell.kind),
            result=result,
            seconds=time.monotonic() - begin_s,
        )
        write_cell(folder, record)
    except CandataError as error:
        return Failure(cell.name, str(error))
    except Exception as error:
        return Failure(cell.name, f"{type(error).__name__}: {error}")
    return record


def dataset_of(record: CellRecord, folder: Path) -> Dataset:
    """Return the dataset of a cell that holds one: one that stood, or its own."""
    return open_dataset(record.result.get("path") or folder / SETS, record.result["digest"])


def _dataset_at(folder: Path) -> Dataset:
    """Return the dataset of a finished cell in a folder."""
    record = CellRecord.model_validate(parse_json((folder / "cell.json").read_bytes()))
    return dataset_of(record, folder)


def _repair(inputs: Mapping[str, Path]) -> tuple[EffectSetting, ...]:
    """Return the effects of a repair among the inputs; none without one."""
    return read_effects(inputs["effects"] / EFFECTS).effects if "effects" in inputs else ()


def _make_data(cell: Cell, folder: Path, inputs: Mapping[str, Path], bench: Bench) -> dict[str, Any]:
    """Return the facts of a set: one that stands is named, others are simulated."""
    if "path" in cell.places:
        return {"path": cell.places["path"], "digest": cell.places["version"]}
    record, done = parse_json(cell.places["record"]), 0

    def progress(count: int) -> None:
        nonlocal done
        done += count
        bench.stage(f"{cell.name}: {done} episodes")

    if "seal" in cell.places:
        world = SealedWorld.model_validate(record)
        seal = bench.out / SEALS / f"{cell.places['seal']}.json"
        dataset = sources.make_sealed(folder / SETS, world, seal, bench.jobs, bench.ray, progress)
    else:
        recipe = SetRecipe.model_validate(record)
        dataset = sources.make_simulated(folder / SETS, recipe, _repair(inputs), bench.jobs, bench.ray, progress)
    return {"digest": dataset.digest, "episodes": len(dataset)}


def _make_part(cell: Cell, folder: Path, inputs: Mapping[str, Path], bench: Bench) -> dict[str, Any]:
    """Return the facts of a part of a real set."""
    bench.stage(cell.name)
    whole = _dataset_at(inputs["data"])
    dataset = sources.make_part(folder / SETS, whole, dict(cell.settings), cell.places.get("scene"))
    return {"digest": dataset.digest, "episodes": len(dataset)}


def _make_diagnosis(cell: Cell, folder: Path, inputs: Mapping[str, Path], bench: Bench) -> dict[str, Any]:
    """Return what a diagnosis says; its files stand in the folder."""
    scene = load_scene(cell.places["scene"])
    diagnosis = diagnose(
        _dataset_at(inputs["data"]),
        scene,
        jobs=bench.jobs,
        seed=cell.settings["seed"],
        cache=bench.cache,
        only=tuple(cell.settings["only"]),
        budget=cell.settings["budget_s"],
        progress=lambda words: bench.stage(f"{cell.name}: {words}"),
    )
    bench.write_diagnosis(diagnosis, scene, folder)
    report = diagnosis.report
    return {
        "verdict": report.verdict,
        "effects": [
            effect.name if effect.element is None else f"{effect.name} {effect.element}" for effect in report.effects
        ],
        "closed": None if report.gap is None else report.gap.closed,
    }


def training_settings(settings: Mapping[str, Any]) -> TrainingSettings:
    """Return how a training cell trains; a short run too is validated a few times."""
    given = TrainingSettings.model_validate({n: settings[n] for n in ("seed", "steps", "batch", "learning_rate")})
    validate_every = max(1, min(given.validate_every, int(settings["steps"]) // VALIDATIONS))
    return given.model_copy(update={"validate_every": validate_every})


def train_request(
    settings: Mapping[str, Any],
    scene: str | None,
    init: Path | None = None,
    effects: tuple[EffectSetting, ...] | None = None,
) -> TrainRequest:
    """Return what a training cell trains; `scene` and `effects` are of a model that reads a simulator."""
    mixture = settings["mixture"]
    text = None if mixture is None else ",".join(f"{name}:{share:g}" for name, share in mixture.items())
    return TrainRequest(
        model=settings["model"],
        preset=None if init else settings["preset"],
        config=None if init else settings["config"],
        init=init,
        mixture=None if text is None else parse_mixture(text),
        scene=scene,
        effects=effects,
        **settings["windows"],
    )


def _make_run(cell: Cell, folder: Path, inputs: Mapping[str, Path], threads: int) -> dict[str, Any]:
    """Return how far a run came, trained in its folder."""
    init = inputs["init"] / RUN if "init" in inputs else None
    data = {role: _dataset_at(inputs[role]) for role in ("data", "sim", "real") if role in inputs}
    has_simulator = find_model(cell.settings["model"]).needs_simulator
    effects = _repair(inputs) if has_simulator else None
    request = train_request(cell.settings, cell.places.get("scene"), init, effects)
    job = prepare(data.get("data") or data, request, training_settings(cell.settings))
    progress = train(job, folder / RUN)
    return {"steps": progress.step, "best_step": progress.best_step, "skipped": progress.skipped}


def _make_evaluation(cell: Cell, folder: Path, inputs: Mapping[str, Path], threads: int) -> dict[str, Any]:
    """Return the name of the model in an evaluation, which stands in the folder."""
    rows = cell.settings["rows"]
    has_simulators = bool({SIMULATOR, REPAIRED} & set(rows))
    truth = cell.settings.get("truth")
    effects = None if truth is None else tuple(EffectSetting.model_validate(effect) for effect in truth)
    if REPAIRED in rows and truth is None:
        effects = _repair(inputs)
    settings = EvaluationSettings(
        group="all",
        baselines=bool(rows),
        simulator=has_simulators,
        scene=cell.places.get("scene") if has_simulators else None,
        effects=effects,
        threads=threads,
        shape=cell.settings.get("windows"),
        **{name: cell.settings[name] for name in ("samples", "steps", "execute", "seed")},
    )
    paths = [inputs["run"] / RUN] if "run" in inputs else []
    evaluation, _tracks = evaluate(paths, _dataset_at(inputs["test"]), settings)
    write_text(folder / EVALUATION, evaluation.model_dump_json(indent=1) + "\n", "evaluation")
    return {"episodes": evaluation.episodes}


def threads_of(jobs: int) -> int:
    """Return the threads of torch in each of so many processes: its own choice for one, shared out."""
    import torch

    return max(1, torch.get_num_threads() // jobs)
