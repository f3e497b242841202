"""From the file of an experiment to its cells: sets, training and test parts, repairs, runs, evaluations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from candata.datasets import Dataset
from candata.errors import UnknownNameError, UsageError
from candata.experiment import standing
from candata.experiment.cells import Cell, content_digest
from candata.experiment.config import FILES, Column, ExperimentFile, ModelEntry, Origin, Regime, SealedWorld
from candata.models import model as find_model
from candata.scenes import load_scene
from candata.scenes.assemble import OBJECT_MARK
from candata.scenes.contract import SCENES
from candata.simulate.recipe import SetRecipe
from candata.training.results import REPAIRED
from candata.training.settings import FINE_TUNE_SHARE


@dataclass(frozen=True)
class Entry:
    """What is evaluated, as one row of the table or a part of one.

    Attributes
    ----------
    column : str
        Column of the table.
    count : int or None
        Real training episodes: 0 for none, None for all.
    cell : str
        Name of the evaluation.
    model, regime, origin, seed
        What was trained and how; None for the rows without training, which share one evaluation.
    """

    column: str
    count: int | None
    cell: str
    model: str | None = None
    regime: Regime | None = None
    origin: Origin = "nominal"
    seed: int | None = None


@dataclass(frozen=True)
class Plan:
    """The cells of an experiment by name, inputs before what they feed, and what the table is made of."""

    file: ExperimentFile
    cells: Mapping[str, Cell]
    entries: tuple[Entry, ...]

    def chosen(self, words: Iterable[str]) -> Plan:
        """Return the plan of the entries that the words choose, with the cells they come from.

        Words of one kind (columns, models, regimes, origins, seeds, numbers of real episodes) are alternatives; words
        of several kinds must all hold. An entry without training is not chosen by model, regime, origin or seed, and
        one of no real episodes not by their number: both stay.

        Raises
        ------
        UnknownNameError
            When a word is a part of no entry.
        """
        kinds = {word: kind for entry in reversed(self.entries) for kind, word in _words_of(entry).items()}
        asked_words: dict[str, set[str]] = {}
        for word in words:
            if word not in kinds:
                raise UnknownNameError("part of the experiment", word, kinds)
            asked_words.setdefault(kinds[word], set()).add(word)
        if "real_count" in asked_words:
            asked_words["real_count"].add(_count_word(0))
        entries = tuple(
            entry
            for entry in self.entries
            if all(word in asked_words.get(kind, {word}) for kind, word in _words_of(entry).items())
        )
        needed = self.ancestors(entry.cell for entry in entries)
        return Plan(self.file, {name: cell for name, cell in self.cells.items() if name in needed}, entries)

    def ancestors(self, names: Iterable[str]) -> set[str]:
        """Return the names of cells, and of all that they come from."""
        needed, waiting = set(), list(names)
        while waiting:
            name = waiting.pop()
            if name not in needed:
                needed.add(name)
                waiting.extend(self.cells[name].inputs.values())
        return needed


def _words_of(entry: Entry) -> dict[str, str]:
    """Return the words that choose an entry, by kind; one without training has no model, regime, origin or seed."""
    words = {"column": entry.column, "real_count": _count_word(entry.count)}
    if entry.model is None:
        return words
    trained = {"model": entry.model, "regime": str(entry.regime), "origin": entry.origin, "seed": f"seed-{entry.seed}"}
    return words | trained


def plan_cells(file: ExperimentFile) -> Plan:
    """Return the cells of an experiment and the entries of its table.

    Raises
    ------
    UsageError
        When a repair is asked for and no scene is known to diagnose in.
    DataError
        When a standing set is missing, or lacks what a model reads.
    """
    planner = _Planner(file, {}, [])
    for title, column in file.columns.items():
        planner.add_column(title, column)
    return Plan(file, planner.cells, tuple(planner.entries))


@dataclass
class _Planner:
    """The cells and entries so far."""

    file: ExperimentFile
    cells: dict[str, Cell]
    entries: list[Entry]
    digests: dict[str, str] = field(default_factory=dict)

    def digest(self, place: str) -> str:
        """Return the digest of a file or an object's folder, read once; a registered object's name as it is."""
        if place not in self.digests:
            self.digests[place] = content_digest(place) if Path(place).is_absolute() else place
        return self.digests[place]

    def scene_digest(self, scene: str) -> str:
        """Return the digest of a scene of the library, which is its name, or of a scene file's compiled model.

        Raises
        ------
        CandataError
            When there is no such scene.
        """
        if scene not in self.digests:
            self.digests[scene] = scene if scene in SCENES else load_scene(scene).digest
        return self.digests[scene]

    def add(self, cell: Cell) -> str:
        """Return the name of a cell, added once."""
        self.cells.setdefault(cell.name, cell)
        return cell.name

    def add_column(self, title: str, column: Column) -> None:
        """Add the cells and entries of a column."""
        standing.check_channels(self.file, title, column)
        standing.check_unseen(self.file, title, column)
        test = self.part(column.real, "test")
        for count in self.file.counts:
            for entry, run in self._runs(title, column, count):
                self._add_entry(entry, test, {"run": run})
            if self.file.rows:
                self._add_rows(title, column, count, test)

    def _add_entry(self, entry: Entry, test: str, inputs: dict[str, str]) -> None:
        """Add the evaluation of a run; one that stands already is that of another number of real episodes."""
        settings = self.file.evaluation.model_dump(mode="json") | {"rows": []}
        if entry.cell not in {other.cell for other in self.entries}:
            self.add(Cell("evaluation", entry.cell, settings, {"test": test, **inputs}))
            self.entries.append(entry)

    def _add_rows(self, title: str, column: Column, count: int | None, test: str) -> None:
        """Add the evaluations of what is not trained: one of the repaired simulator, one of all else."""
        scene = self._scene(column)
        settings = self.file.evaluation.model_dump(mode="json")
        settings |= {"windows": self.file.windows.model_dump(mode="json"), **self._scene_settings(scene)}
        plain_rows = [row for row in self.file.rows if row != REPAIRED]
        name = f"evaluation/{title}/rows"
        if plain_rows and name not in self.cells:
            self.add(Cell("evaluation", name, settings | {"rows": plain_rows}, {"test": test}, _scene_place(scene)))
            self.entries.append(Entry(title, 0, name))
        if REPAIRED in self.file.rows:
            inputs = {"test": test, "effects": self.diagnosis(title, column, count)}
            name = f"evaluation/{title}/{REPAIRED}/{_count_word(count)}"
            self.add(Cell("evaluation", name, settings | {"rows": [REPAIRED]}, inputs, _scene_place(scene)))
            self.entries.append(Entry(title, count, name))

    def _runs(self, title: str, column: Column, count: int | None) -> Iterator[tuple[Entry, str]]:
        """Yield each run of a column with its entry."""
        for name, entry in self.file.models.items():
            for origin in entry.origins or self.file.origins:
                for regime in self.file.regimes:
                    if regime == "real" and origin == "repaired" and not _needs_simulator(entry.model or name):
                        continue  # what never saw a simulation knows of no repair
                    for seed in self.file.seeds:
                        run = self.run(title, column, count, name, origin, regime, seed)
                        # Without a repair, what never saw a real episode is the same for all numbers of them.
                        shown = 0 if regime == "sim" and origin == "nominal" else count
                        cell = f"evaluation/{title}/{name}/{origin}/{regime}/{_count_word(shown)}/seed-{seed}"
                        yield Entry(title, shown, cell, name, regime, origin, seed), run

    def run(
        self, title: str, column: Column, count: int | None, name: str, origin: Origin, regime: Regime, seed: int
    ) -> str:
        """Return the name of the last training cell of a model in a regime."""
        entry = self.file.models[name]
        effects = self.diagnosis(title, column, count) if origin == "repaired" else None
        simulator = {"effects": effects} if effects and _needs_simulator(entry.model or name) else {}
        head = f"train/{title}/{name}/{origin}"
        count_text = "" if effects is None else f"/{_count_word(count)}"
        if regime == "real":
            inputs = {"data": self.part(column.real, _count_word(count)), **simulator}
            return self._train(f"{head}/real/{_count_word(count)}/seed-{seed}", column, entry, name, seed, inputs)
        sim = self.simulated(str(column.sim), effects, count)
        tuned = self._train(
            f"{head}/sim{count_text}/seed-{seed}", column, entry, name, seed, {"data": sim, **simulator}
        )
        if column.larger is not None:
            sim = self.simulated(column.larger, effects, count)
            inputs = {"data": sim, "init": tuned, **simulator}
            tuned = self._train(f"{head}/larger{count_text}/seed-{seed}", column, entry, name, seed, inputs)
        if regime == "sim":
            return tuned
        inputs = {"sim": sim, "real": self.part(column.real, _count_word(count)), "init": tuned, **simulator}
        return self._train(f"{head}/real-finetune/{_count_word(count)}/seed-{seed}", column, entry, name, seed, inputs)

    def _train(
        self, cell_name: str, column: Column, entry: ModelEntry, name: str, seed: int, inputs: dict[str, str]
    ) -> str:
        """Return the name of a training cell, added once."""
        is_tuned = "init" in inputs
        steps = entry.fine_tune_steps if is_tuned and entry.fine_tune_steps else entry.steps
        rate = (entry.fine_tune_rate or FINE_TUNE_SHARE * entry.learning_rate) if is_tuned else entry.learning_rate
        settings = {
            "model": entry.model or name,
            "preset": entry.preset,
            "config": entry.config,
            "steps": steps,
            "batch": entry.batch,
            "learning_rate": rate,
            "seed": seed,
            "windows": self.file.windows.model_dump(mode="json"),
            "mixture": self.file.mixture if "real" in inputs else None,
        }
        if not _needs_simulator(entry.model or name):
            return self.add(Cell("train", cell_name, settings, inputs))
        scene = self._scene(column)
        return self.add(Cell("train", cell_name, settings | self._scene_settings(scene), inputs, _scene_place(scene)))

    def _simulated_cell(self, name: str, recipe: SetRecipe) -> Cell:
        """Return the cell of a simulated set."""
        return Cell("data", name, self._portable(recipe), places={"record": recipe.model_dump_json()})

    def _sealed_cell(self, source_name: str, sealed: SealedWorld) -> Cell:
        """Return the cell of a world that stands in for the real one; worlds of one name share their seal."""
        places = {"record": sealed.model_dump_json(), "seal": sealed.world or source_name}
        return Cell("data", f"data/{source_name}", self._portable(sealed), places=places)

    def _portable(self, record: SetRecipe | SealedWorld) -> dict[str, Any]:
        """Return the settings of a set without the places of its files, and the digests of what these hold."""
        settings = record.model_dump(mode="json")
        files = {name: self.digest(settings.pop(name)) for name in FILES if settings.get(name) is not None}
        objects = {"objects": _last_names(record.objects), "shapes": [self.digest(name) for name in record.objects]}
        return settings | objects | self._scene_settings(record.scene) | {"files": files}

    def _scene_settings(self, scene: str | None) -> dict[str, Any]:
        """Return what decides of a scene: names without places, and digests."""
        if scene is None:
            return {"scene": None}
        base, *objects = scene.split(OBJECT_MARK)
        content = [self.scene_digest(base), *(self.digest(name) for name in objects)]
        return {"scene": _last_names([base, *objects]), "scene_content": content}

    def simulated(self, source_name: str, effects: str | None, count: int | None) -> str:
        """Return the name of a simulated or standing set to pre-train on, of the repaired simulator with `effects`."""
        recipe = self.file.data[source_name].generate
        if recipe is None:
            if effects is not None:
                raise UsageError(
                    f"{source_name} stands and cannot be simulated with the repair", expected="recipe or generate"
                )
            return self.add(_standing_cell(source_name, standing.standing_set(self.file, source_name)))
        if effects is None:
            return self.add(self._simulated_cell(f"data/{source_name}", recipe))
        cell = self._simulated_cell(f"data/{source_name}/repaired/{_count_word(count)}/{effects}", recipe)
        return self.add(replace(cell, inputs={"effects": effects}))

    def part(self, source_name: str, word: str) -> str:
        """Return the name of a part of a real set: `test`, `train-N` or `train-all`."""
        source = self.file.data[source_name]
        if source.sealed is not None:
            whole = self.add(self._sealed_cell(source_name, source.sealed))
            settings: dict[str, Any] = {"part": word, "train": source.sealed.train}
        else:
            whole = self.add(_standing_cell(source_name, standing.standing_set(self.file, source_name)))
            cloud = {} if source.cloud_of is None else {"cloud_of": self._scene_settings(source.cloud_of)}
            settings = {"part": word, "split": source.split, **cloud}
        name = f"part/{source_name}/{word}"
        return self.add(Cell("part", name, settings, {"data": whole}, _scene_place(source.cloud_of)))

    def diagnosis(self, title: str, column: Column, count: int | None) -> str:
        """Return the name of the diagnosis of the training part of a real set."""
        diagnosed = column.diagnosed or column.real
        scene = self._diagnosed_scene(title, column, diagnosed)
        settings = self.file.diagnosis.model_dump(mode="json") | self._scene_settings(scene)
        inputs = {"data": self.part(diagnosed, _count_word(count))}
        name = f"diagnosis/{diagnosed}/{_count_word(count)}"
        return self.add(Cell("diagnosis", name, settings, inputs, {"scene": scene}))

    def _scene(self, column: Column) -> str | None:
        """Return the scene that simulators of a column play in: with several objects, their common folder in it."""
        sealed = self.file.data[column.real].sealed
        if column.scene is not None or sealed is None or not sealed.objects:
            return column.scene or (None if sealed is None else sealed.scene)
        folders = {str(Path(name).parent) for name in sealed.objects}
        is_single = len(sealed.objects) == 1
        if not is_single and len(folders) > 1:
            raise UsageError(
                f"the objects of {column.real} lie in {len(folders)} folders",
                expected="folders of objects in one folder",
                found=", ".join(sorted(folders)[:4]),
                fix="put them, or links to them, in one folder",
            )
        return f"{sealed.scene}{OBJECT_MARK}{sealed.objects[0] if is_single else folders.pop()}"

    def _diagnosed_scene(self, title: str, column: Column, diagnosed: str) -> str:
        """Return the nominal scene of a diagnosis."""
        sealed = self.file.data[diagnosed].sealed
        if column.scene is not None:
            return column.scene
        if sealed is None:
            raise UsageError(f"column {title} has a repair and no scene", expected="scene: NAME or scene.yaml")
        if len(sealed.objects) > 1:
            raise UsageError(
                f"column {title}: a diagnosis is of one object, and {diagnosed} has {len(sealed.objects)}",
                fix="name recordings of one object with `diagnosed`, of the same `world`",
            )
        return str(self._scene(Column(real=diagnosed)))


def _needs_simulator(model_name: str) -> bool:
    """Tell whether a model's input holds a simulator's forecast."""
    return find_model(model_name).needs_simulator


def _count_word(count: int | None) -> str:
    """Return `train-all`, or `train-30`."""
    return "train-all" if count is None else f"train-{count}"


def _standing_cell(source_name: str, dataset: Dataset) -> Cell:
    """Return the cell of a set that stands: nothing is made, and its version is the digest."""
    places = {"path": str(dataset.path), "version": dataset.digest}
    return Cell("data", f"data/{source_name}", {"digest": dataset.digest}, places=places)


def _scene_place(scene: str | None) -> dict[str, str]:
    """Return the place of a scene, for a cell."""
    return {} if scene is None else {"scene": scene}


def _last_names(texts: Sequence[str]) -> list[str]:
    """Return the last part of each path, and other texts as they are."""
    return [Path(text).name for text in texts]
