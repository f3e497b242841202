"""What an experiment will take: hours and gigabytes of its cells, from short trials that leave nothing."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset, open_dataset
from candata.experiment.cells import Cell, cell_folder, digests, read_cell
from candata.experiment.config import SealedWorld
from candata.experiment.plan import Plan
from candata.experiment.sources import TRAINED_ON, copy_episodes, part_ids
from candata.experiment.work import dataset_of, threads_of, train_request, training_settings
from candata.loaders import windows
from candata.models import model as find_model
from candata.scenes.assemble import OBJECT_MARK
from candata.schema.json_text import parse_json
from candata.schema.record import Record
from candata.simulate.forecast import Forecast, forecast
from candata.simulate.generate import generate
from candata.simulate.recipe import SetOptions, SetRecipe
from candata.training.checkpoint import LAST_FILE
from candata.training.evaluation import EvaluationSettings, evaluate
from candata.training.jobs import HELD_OUT_BATCHES, prepare
from candata.training.loop import train
from candata.training.results import REPAIRED, SIMULATOR
from candata.training.simulated import rows_apart

#: Steps of a trial of a model, of which the last third is timed: the first ones compile and allocate. Chosen.
TRIAL_STEPS = 9
#: Episodes of a trial set: the fewest of which a default split fills its three groups.
TRIAL_EPISODES = 3
#: Windows that a trial trains on, and as many to validate: what a simulator forecasts in half a second. Chosen.
TRIAL_WINDOWS = 16


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


@dataclass(frozen=True)
class _ModelTimes:
    """What a trial of a model took.

    Attributes
    ----------
    step_s, episode_s, window_s : float
        Seconds a step of training, an episode of an evaluation, and a window that the simulator forecasts.
    bytes_kept : float
        Size of its checkpoints.
    windows : float
        Windows an episode, of which every row begins one.
    stride : (1,) int64
        Rows a step.
    """

    step_s: float
    episode_s: float
    window_s: float
    bytes_kept: float
    windows: float
    stride: NDArray[np.int64]


@dataclass
class _Trials:
    """What was measured, each once."""

    plan: Plan
    out: Path
    jobs: int
    stage: Callable[[str], None]
    folder: Path
    sets: dict[str, Forecast] = field(default_factory=dict)
    models: dict[str, _ModelTimes] = field(default_factory=dict)
    rows: dict[str, float] = field(default_factory=dict)
    datasets: dict[str, Dataset] = field(default_factory=dict)
    simulated: set[tuple[str, str | None]] = field(default_factory=set)


def forecast_cells(
    plan: Plan, out: Path, jobs: int, stage: Callable[[str], None] = lambda _words: None
) -> tuple[CellForecast, ...]:
    """Return what each cell will take, in the order of the plan.

    Sets are forecast by a trial of a few episodes, models by a few steps, a few simulated windows and an evaluation of
    one episode. What was not tried takes what its like takes, by its number of episodes and steps: sets of the same
    motions and simulators of the same scene, whatever the object. A cell of one digest with another counts once.

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
    import torch

    names, threads = digests(plan.cells), torch.get_num_threads()
    torch.set_num_threads(threads_of(jobs))
    try:
        with tempfile.TemporaryDirectory() as folder:
            return _forecasts(_Trials(plan, out, jobs, stage, Path(folder)), names)
    finally:
        torch.set_num_threads(threads)


def _forecasts(trials: _Trials, names: Mapping[str, str]) -> tuple[CellForecast, ...]:
    """Return what each cell will take, by trials of those that do not stand."""
    rows, counted = [], set()
    for name, cell in trials.plan.cells.items():
        stands = read_cell(cell_folder(trials.out, cell, names[name]), names[name]) is not None
        hours: float | None = None
        gigabytes: float | None = None
        if not stands:
            hours, gigabytes = (0.0, 0.0) if names[name] in counted else _MEASURES[cell.kind](cell, trials)
        counted.add(names[name])
        rows.append(CellForecast(name=name, kind=cell.kind, stands=stands, hours=hours, gigabytes=gigabytes))
    return tuple(rows)


def total_hours(rows: tuple[CellForecast, ...], jobs: int) -> float:
    """Return the hours of all cells: runs and evaluations side by side in so many processes."""
    side_by_side = sum(row.hours or 0.0 for row in rows if row.kind in ("train", "evaluation"))
    return sum(row.hours or 0.0 for row in rows if row.kind not in ("train", "evaluation")) + side_by_side / jobs


def _set_forecast(cell: Cell, trials: _Trials) -> tuple[float | None, float | None]:
    """Return hours and gigabytes of a simulated set; nothing for one that stands."""
    if "record" not in cell.places:
        return 0.0, 0.0
    scene, episodes, seed, options = _as_generation(cell)
    key = str([scene, *(options.get(name) for name in ("policies", "policy_file", "duration_s", "outcomes"))])
    if key not in trials.sets:
        trials.stage(f"trying {cell.name}")
        trials.sets[key] = forecast(scene, episodes, seed, workers=trials.jobs, **options)
    tried = trials.sets[key]
    if tried.minutes is None or tried.gigabytes is None:
        return None, None
    share = episodes / tried.episodes
    return share * tried.minutes / 60, share * tried.gigabytes


def _as_generation(cell: Cell) -> tuple[str, int, int, SetOptions]:
    """Return scene, episodes, seed and options of a set, with the first of its objects alone.

    A sealed world takes as long as its nominal scene, and any object as long as another; each takes a while to load.
    """
    record = parse_json(cell.places["record"])
    if "seal" not in cell.places:
        recipe = SetRecipe.model_validate(record)
        scene, episodes, seed, options = recipe.scene, recipe.episodes, recipe.seed, recipe.options()
    else:
        world = SealedWorld.model_validate(record)
        scene, episodes, seed = world.scene, world.train + world.test, world.seed
        options = {"objects": world.objects, "policies": world.policies, "duration_s": world.duration_s}
    return scene, episodes, seed, options | {"objects": options["objects"][:1]}


def _diagnosis_forecast(cell: Cell, trials: _Trials) -> tuple[float | None, float | None]:
    """Return the hours that a diagnosis may take at most; None without a limit."""
    budget_s = cell.settings["budget_s"]
    return None if budget_s is None else budget_s / 3600 / trials.jobs, 0.0


def _run_forecast(cell: Cell, trials: _Trials) -> tuple[float | None, float | None]:
    """Return hours and gigabytes of a run."""
    times = _tried(cell, trials)
    seconds = cell.settings["steps"] * times.step_s
    if find_model(cell.settings["model"]).needs_simulator:
        seconds += _windows_to_simulate(cell, trials, times) * times.window_s
    return seconds / 3600, times.bytes_kept / 1e9


def _windows_to_simulate(cell: Cell, trials: _Trials, times: _ModelTimes) -> float:
    """Return how many windows of a run the simulator forecasts that no run before it had forecast."""
    most_held_out, count = cell.settings["batch"] * HELD_OUT_BATCHES, 0.0
    for name in (cell.inputs[role] for role in ("data", "sim", "real") if role in cell.inputs):
        source = (name, cell.inputs.get("effects"))
        if source in trials.simulated:
            continue
        trials.simulated.add(source)
        all_windows = _episodes(trials.plan.cells[name], trials) * times.windows
        trained = round(TRAINED_ON["train"] * all_windows)
        count += trained / int(rows_apart(trained, times.stride)[0])
        count += min(TRAINED_ON["val"] * all_windows, most_held_out)
    return count


def _evaluation_forecast(cell: Cell, trials: _Trials) -> tuple[float | None, float | None]:
    """Return the hours of an evaluation."""
    if "run" in cell.inputs:
        episode_s = _tried(trials.plan.cells[cell.inputs["run"]], trials).episode_s
    else:
        episode_s = _rows_tried(cell, trials)
    return _episodes(trials.plan.cells[cell.inputs["test"]], trials) * episode_s / 3600, 0.0


def _rows_tried(cell: Cell, trials: _Trials) -> float:
    """Return the seconds an episode of an evaluation without runs; a repaired simulator takes as long as a nominal."""
    has_simulator = bool({SIMULATOR, REPAIRED} & set(cell.settings["rows"]))
    scene = cell.places.get("scene") if has_simulator else None
    key = str(scene).partition(OBJECT_MARK)[0]
    if key not in trials.rows:
        trials.stage(f"trying {cell.name}")
        settings = EvaluationSettings(simulator=has_simulator, scene=scene, shape=cell.settings["windows"])
        trials.rows[key] = _evaluation_s([], _trial_set(cell, trials), settings)
    return trials.rows[key] * (2 if REPAIRED in cell.settings["rows"] else 1)


def _evaluation_s(paths: list[Path], dataset: Dataset, settings: EvaluationSettings) -> float:
    """Return the seconds an episode of an evaluation on the test episode of a trial set."""
    import torch

    begin_s = time.perf_counter()
    evaluation, _ = evaluate(paths, dataset, replace(settings, threads=torch.get_num_threads()))
    return (time.perf_counter() - begin_s) / evaluation.episodes


def _episodes(cell: Cell, trials: _Trials) -> int:
    """Return how many episodes a set or a part holds."""
    if cell.kind == "data":
        return len(open_dataset(cell.places["path"])) if "path" in cell.places else _as_generation(cell)[1]
    whole, word = _source(cell, trials), str(cell.settings["part"]).removeprefix("train-")
    if "path" in whole.places:
        return len(part_ids(open_dataset(whole.places["path"], whole.places["version"]), dict(cell.settings)))
    world = SealedWorld.model_validate(parse_json(whole.places["record"]))
    return {"test": world.test, "all": world.train}.get(word) or int(word)


def _tried(cell: Cell, trials: _Trials) -> _ModelTimes:
    """Return what a model takes."""
    kept = ("model", "preset", "config", "batch", "windows")
    key = str({name: cell.settings[name] for name in kept})
    if key not in trials.models:
        trials.stage(f"trying {cell.settings['model']}")
        trials.models[key] = _trial(cell, trials)
    return trials.models[key]


def _trial(cell: Cell, trials: _Trials) -> _ModelTimes:
    """Return what a short run and its evaluation took."""
    settings, dataset, scoring = cell.settings, _trial_set(cell, trials), trials.plan.file.evaluation
    folder = trials.folder / f"run-{len(trials.models)}"
    request = replace(
        train_request({**settings, "mixture": None}, cell.places.get("scene")),
        forecasts=trials.folder,
        most_windows=TRIAL_WINDOWS,
    )
    short = training_settings({**settings, "steps": TRIAL_STEPS}).model_copy(
        update={"log_every": TRIAL_STEPS // 3, "validate_every": TRIAL_STEPS}
    )
    rates: list[float] = []
    simulated_s: list[float] = []
    job = prepare(dataset, request, short, simulating=lambda _done, _total: simulated_s.append(time.perf_counter()))
    train(job, folder, lambda report: rates.append(report.windows_per_s))
    every_row = windows(dataset, channels=("object_pose",), **settings["windows"])
    given = scoring.model_dump(include={"samples", "steps", "execute", "seed"})
    return _ModelTimes(
        step_s=settings["batch"] / rates[-1],
        episode_s=_evaluation_s([folder], dataset, EvaluationSettings(baselines=False, simulator=False, **given)),
        # The windows of the validation come first, and load the scene.
        window_s=(simulated_s[-1] - simulated_s[0]) / TRIAL_WINDOWS if simulated_s else 0.0,
        bytes_kept=2.0 * (folder / LAST_FILE).stat().st_size,
        windows=len(every_row) / len(dataset),
        stride=every_row.stride[:1],
    )


def _source(cell: Cell, trials: _Trials) -> Cell:
    """Return the set that a cell comes from."""
    while cell.kind != "data":
        role = next(role for role in ("data", "sim", "test") if role in cell.inputs)
        cell = trials.plan.cells[cell.inputs[role]]
    return cell


def _trial_set(cell: Cell, trials: _Trials) -> Dataset:
    """Return a few episodes to try a cell on: of its set, where that stands, or simulated."""
    source = _source(cell, trials)
    key = source.places.get("record") or source.places["path"]
    if key not in trials.datasets:
        root = trials.folder / f"set-{len(trials.datasets)}"
        standing = _standing_set(source, trials)
        if standing is None:
            scene, _, seed, options = _as_generation(source)
            generate(root, scene, TRIAL_EPISODES, seed, workers=1, **options)
        else:
            cloud_of = trials.plan.file.data[source.name.split("/")[1]].cloud_of
            copy_episodes(root, standing, standing.ids[:TRIAL_EPISODES], {}, cloud_of)
        trials.datasets[key] = open_dataset(root)
    return trials.datasets[key]


def _standing_set(source: Cell, trials: _Trials) -> Dataset | None:
    """Return the dataset of a set that stands; None of another."""
    if "path" in source.places:
        return open_dataset(source.places["path"], source.places["version"])
    digest = digests(trials.plan.cells)[source.name]
    folder = cell_folder(trials.out, source, digest)
    record = read_cell(folder, digest)
    return None if record is None else dataset_of(record, folder)


_MEASURES: Mapping[str, Callable[[Cell, _Trials], tuple[float | None, float | None]]] = {
    "data": _set_forecast,
    "part": lambda cell, trials: (0.0, 0.0),
    "diagnosis": _diagnosis_forecast,
    "train": _run_forecast,
    "evaluation": _evaluation_forecast,
}
