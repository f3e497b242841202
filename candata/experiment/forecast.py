"""What an experiment will take: hours and gigabytes of its cells, from short trials that leave nothing."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from candata.datasets import Dataset, open_dataset
from candata.experiment.cells import Cell, cell_folder, digests, read_cell
from candata.experiment.config import SealedWorld
from candata.experiment.plan import Plan
from candata.experiment.work import dataset_of, train_request, training_settings
from candata.schema.json_text import parse_json
from candata.schema.record import Record
from candata.simulate.forecast import Forecast, forecast
from candata.simulate.generate import generate
from candata.simulate.recipe import SetRecipe
from candata.training.checkpoint import LAST_FILE
from candata.training.evaluation import EvaluationSettings, evaluate
from candata.training.jobs import prepare
from candata.training.loop import train

#: Steps of a trial of a model, of which the last third is timed: the first ones compile and allocate. Chosen.
TRIAL_STEPS = 9
#: Episodes of a trial set. Chosen: a default split fills its three groups.
TRIAL_EPISODES = 6


class CellForecast(Record):
    """What one cell will take.

    `hours` are those of one process for runs and evaluations, of all processes for sets, and the most that a diagnosis
    may take; null where nothing is known. `stands` is true for a cell that needs no work.
    """

    name: str
    kind: str
    stands: bool
    hours: float | None = None
    gigabytes: float | None = None


@dataclass
class _Trials:
    """What was measured, each once."""

    plan: Plan
    out: Path
    jobs: int
    stage: Callable[[str], None]
    sets: dict[str, Forecast] = field(default_factory=dict)
    runs: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    trial_set: Dataset | None = None


def forecast_cells(
    plan: Plan, out: Path, jobs: int, stage: Callable[[str], None] = lambda _words: None
) -> tuple[CellForecast, ...]:
    """Return what each cell will take, in the order of the plan.

    Sets are forecast by a trial of a few episodes, models by a few steps and an evaluation on a trial set; what was
    not tried takes what its like takes, by its number of episodes and steps.

    Parameters
    ----------
    plan : Plan
        Cells.
    out : Path
        Folder of the experiment, in which cells may stand.
    jobs : int
        Processes.
    stage : callable
        Hears what is being tried.

    Raises
    ------
    CandataError
        When a set or a model of it cannot be made.
    """
    names = digests(plan.cells)
    with tempfile.TemporaryDirectory() as folder:
        trials = _Trials(plan, out, jobs, stage)
        rows = []
        for name, cell in plan.cells.items():
            if read_cell(cell_folder(out, cell, names[name]), names[name]) is not None:
                rows.append(CellForecast(name=name, kind=cell.kind, stands=True))
                continue
            hours, gigabytes = _MEASURES[cell.kind](cell, trials, Path(folder))
            rows.append(CellForecast(name=name, kind=cell.kind, stands=False, hours=hours, gigabytes=gigabytes))
    return tuple(rows)


def total_hours(rows: tuple[CellForecast, ...], jobs: int) -> float:
    """Return the hours of all cells: runs and evaluations side by side in so many processes."""
    side_by_side = sum(row.hours or 0.0 for row in rows if row.kind in ("train", "evaluation"))
    return sum(row.hours or 0.0 for row in rows if row.kind not in ("train", "evaluation")) + side_by_side / jobs


def _set_forecast(cell: Cell, trials: _Trials, folder: Path) -> tuple[float | None, float | None]:
    """Return hours and gigabytes of a simulated set; nothing for one that stands."""
    if "record" not in cell.places:
        return 0.0, 0.0
    key = cell.places["record"]
    if key not in trials.sets:
        trials.stage(f"trying {cell.name}")
        scene, episodes, seed, options = _as_generation(cell)
        trials.sets[key] = forecast(scene, episodes, seed, workers=trials.jobs, **options)
    found = trials.sets[key]
    return None if found.minutes is None else found.minutes / 60, found.gigabytes


def _as_generation(cell: Cell) -> tuple[str, int, int, Any]:
    """Return scene, episodes, seed and options of a set; a sealed world takes as long as its nominal scene."""
    record = parse_json(cell.places["record"])
    if "seal" not in cell.places:
        recipe = SetRecipe.model_validate(record)
        return recipe.scene, recipe.episodes, recipe.seed, recipe.options()
    world = SealedWorld.model_validate(record)
    options = {"objects": world.objects, "policies": world.policies, "duration_s": world.duration_s}
    return world.scene, world.train + world.test, world.seed, options


def _diagnosis_forecast(cell: Cell, trials: _Trials, folder: Path) -> tuple[float | None, float | None]:
    """Return the hours that a diagnosis may take at most; None without a limit."""
    budget_s = cell.settings["budget_s"]
    return None if budget_s is None else budget_s / 3600 / trials.jobs, 0.0


def _run_forecast(cell: Cell, trials: _Trials, folder: Path) -> tuple[float | None, float | None]:
    """Return hours and gigabytes of a run."""
    step_s, _, bytes_kept = _tried(cell, trials, folder)
    return cell.settings["steps"] * step_s / 3600, bytes_kept / 1e9


def _evaluation_forecast(cell: Cell, trials: _Trials, folder: Path) -> tuple[float | None, float | None]:
    """Return the hours of an evaluation."""
    if "run" in cell.inputs:
        _, episode_s, _ = _tried(trials.plan.cells[cell.inputs["run"]], trials, folder)
    else:
        episode_s = _rows_tried(cell, trials, folder)
    return _test_episodes(cell, trials) * episode_s / 3600, 0.0


def _rows_tried(cell: Cell, trials: _Trials, folder: Path) -> float:
    """Return the seconds an episode of an evaluation of simulators and baselines."""
    settings = EvaluationSettings(
        group="all",
        simulator="scene" in cell.places,
        scene=cell.places.get("scene"),
        effects=() if "effects" in cell.inputs and "scene" in cell.places else None,
        shape=cell.settings["windows"],
    )
    begin_s = time.perf_counter()
    evaluation, _ = evaluate([], _trial_set(trials, folder), settings)
    return (time.perf_counter() - begin_s) / evaluation.episodes


def _test_episodes(cell: Cell, trials: _Trials) -> int:
    """Return how many episodes an evaluation scores, as far as the plan knows it."""
    whole = trials.plan.cells[trials.plan.cells[cell.inputs["test"]].inputs["data"]]
    if "record" in whole.places:
        return SealedWorld.model_validate(parse_json(whole.places["record"])).test
    return len(open_dataset(whole.places["path"]))


def _tried(cell: Cell, trials: _Trials, folder: Path) -> tuple[float, float, float]:
    """Return seconds a step, seconds an episode of an evaluation, and bytes of the checkpoints of a model."""
    kept = ("model", "preset", "config", "batch", "windows")
    key = str({name: cell.settings[name] for name in kept})
    if key not in trials.runs:
        trials.stage(f"trying {cell.settings['model']}")
        trials.runs[key] = _trial(cell, _trial_set(trials, folder), folder / f"run-{len(trials.runs)}")
    return trials.runs[key]


def _trial(cell: Cell, dataset: Dataset, folder: Path) -> tuple[float, float, float]:
    """Return what a short run and its evaluation took."""
    settings = cell.settings
    request = train_request({**settings, "mixture": None}, cell.places.get("scene"))
    short = training_settings({**settings, "steps": TRIAL_STEPS}).model_copy(update={"log_every": TRIAL_STEPS // 3})
    rates: list[float] = []
    train(prepare(dataset, request, short), folder, lambda report: rates.append(report.windows_per_s))
    begin_s = time.perf_counter()
    evaluation, _ = evaluate([folder], dataset, EvaluationSettings(group="all", samples=1, steps=1, simulator=False))
    episode_s = (time.perf_counter() - begin_s) / evaluation.episodes
    return settings["batch"] / rates[-1], episode_s, 2.0 * (folder / LAST_FILE).stat().st_size


def _trial_set(trials: _Trials, folder: Path) -> Dataset:
    """Return a few episodes to try models on: of a set that stands, or of the first one that is simulated."""
    if trials.trial_set is None:
        trials.trial_set = _standing_set(trials) or _simulated_trial(trials, folder / "trial")
    return trials.trial_set


def _standing_set(trials: _Trials) -> Dataset | None:
    """Return a set or a part that stands; None where none does."""
    names = digests(trials.plan.cells)
    for name, cell in trials.plan.cells.items():
        if cell.kind not in ("data", "part"):
            continue
        if "path" in cell.places:
            return open_dataset(cell.places["path"], cell.places["version"])
        folder = cell_folder(trials.out, cell, names[name])
        record = read_cell(folder, names[name])
        if record is not None:
            return dataset_of(record, folder)
    return None


def _simulated_trial(trials: _Trials, root: Path) -> Dataset:
    """Return a few simulated episodes."""
    cell = next(cell for cell in trials.plan.cells.values() if cell.kind == "data")
    scene, _, seed, options = _as_generation(cell)
    generate(root, scene, TRIAL_EPISODES, seed, workers=1, **options)
    return open_dataset(root)


_MEASURES: Mapping[str, Callable[[Cell, _Trials, Path], tuple[float | None, float | None]]] = {
    "data": _set_forecast,
    "part": lambda cell, trials, folder: (0.0, 0.0),
    "diagnosis": _diagnosis_forecast,
    "train": _run_forecast,
    "evaluation": _evaluation_forecast,
}
