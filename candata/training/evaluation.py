"""`evaluate`: a run's checkpoint on held-out episodes of a dataset."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from candata import __version__
from candata.datasets import Dataset
from candata.errors import UnknownNameError, UsageError
from candata.loaders import Split, Windows, find_split, split_digest, split_names, windows
from candata.loaders.splits import GROUPS
from candata.models import model as find_model
from candata.training import checkpoint, feed, jobs, runs
from candata.training.data import channels_for
from candata.training.forecasters import BASELINES, Forecaster, Trained
from candata.training.results import Evaluation, Scores, Track
from candata.training.scoring import Findings, chosen_windows, score
from candata.training.settings import Run

#: Steps of a chunk in closed loop, half the default horizon.
EXECUTE = 8


@dataclass(frozen=True)
class Manner:
    """How to evaluate.

    Attributes
    ----------
    group : str
        `train`, `val` or `test` of the run's split, or `all` episodes.
    samples : int
        Samples averaged.
    steps : int
        Steps of the sampler.
    execute : int or None
        Steps executed before the next forecast in closed loop; by default 8, or the horizon where that is shorter.
    seed : int
        Seed of the noise.
    device : str
        `cpu` or `cuda`.
    """

    group: str = "test"
    samples: int = 16
    steps: int = 10
    execute: int | None = None
    seed: int = 0
    device: str = "cpu"


def evaluate(
    path: Path, dataset: Dataset, manner: Manner, stage: Callable[[str], None] = lambda _name: None
) -> tuple[Evaluation, tuple[Track, ...]]:
    """Return what was found, and a few episodes for the figures.

    Parameters
    ----------
    path : Path
        Folder of a run (its best checkpoint), or a checkpoint.
    dataset : Dataset
        Version to evaluate on.
    manner : Manner
        How.
    stage : callable
        Called with what is being done.

    Raises
    ------
    UsageError
        When there is no checkpoint, it is a pickle, it is of another hand, or a number is out of range.
    DataError
        When the checkpoint is damaged, the group is empty, or no episode is as long as the horizon.
    """
    kept = checkpoint.read(path)
    run = kept.run
    execute = manner.execute if manner.execute is not None else min(EXECUTE, run.sizes["horizon"])
    _check(manner, execute, run)
    jobs.check_device(manner.device)
    split, name = split_of(kept.path.parent, run, dataset)
    stage("reading the dataset")
    chosen = _windows(dataset, split, run, manner.group)
    jobs.check_data(kept, chosen)
    model = Trained(
        jobs.trained(kept, manner.device), feed.clouds_of(chosen, manner.device), manner.samples, manner.steps,
        manner.device, f"the model ({run.model}, mean of {manner.samples} samples)",
    )  # fmt: skip
    forecasters: dict[str, Forecaster] = {run.model: model, **BASELINES}
    found = score(chosen, forecasters, execute, manner.seed, stage)
    seen = _seen(kept, split if run.digest == dataset.digest else None, found)
    return Evaluation(
        run=path.name, checkpoint=kept.path.name, step=kept.progress.step, model=run.model,
        trained_on=f"{run.dataset}@{run.digest[:12]}", dataset=f"{dataset.name}@{dataset.digest[:12]}",
        split=name, group=manner.group, seen_episodes=seen, episodes=len(found.by_episode),
        windows=len(chosen_windows(chosen)), rows=found.rows, rate_hz=run.rate_hz,
        history=run.sizes["history"], horizon=run.sizes["horizon"],
        samples=manner.samples, sampling_steps=manner.steps, execute=execute, seed=manner.seed,
        contact_from=_contact_from(run, found), gain=found.gain, by_episode=found.by_episode,
        forecasters={
            key: Scores(summary=one.summary, windows=found.windows[key], closed_loop=found.closed_loop[key])
            for key, one in forecasters.items()
        },
        revision=__version__,
    ), found.tracks  # fmt: skip


def _check(manner: Manner, execute: int, run: Run) -> None:
    """Refuse numbers that mean nothing."""
    known = (*GROUPS, "all")
    if manner.group not in known:
        raise UnknownNameError("group of a split", manner.group, known)
    for name, value, most in (
        ("samples", manner.samples, None),
        ("steps", manner.steps, run.config.get("train_steps")),
        ("execute", execute, run.sizes["horizon"]),
    ):
        if value < 1 or (most is not None and value > most):
            raise UsageError(
                f"--{name} is out of range", expected=f"1 to {most}" if most else "at least 1", found=str(value)
            )


def split_of(folder: Path, run: Run, dataset: Dataset) -> tuple[Split, str]:
    """Return the split to evaluate by and its name: the run's own on its own data, else the one the dataset has."""
    splits = runs.read_splits(folder, run)
    place = next((i for i, source in enumerate(run.trained_on) if source.digest == dataset.digest), None)
    if place is not None and splits is not None:
        return splits[place], run.split
    name = run.split if run.split in split_names(dataset) else None
    found = find_split(dataset, name)
    if place is not None and split_digest(found) != run.trained_on[place].split_digest:
        raise UsageError(
            "the split of the run is not there any more", expected=f"{runs.SPLIT} beside the checkpoint",
            found=f"a split {run.split} of other episodes", fix="evaluate the run's folder, or another dataset",
        )  # fmt: skip
    return found, name or "default"


def _windows(dataset: Dataset, split: Split, run: Run, group: str) -> Windows:
    """Return a window at every step of the model."""
    given: dict[str, Any] = {
        "history": run.sizes["history"], "horizon": run.sizes["horizon"], "rate_hz": run.rate_hz,
        "channels": channels_for(run.channels, dataset),
    }  # fmt: skip
    if group != "all":
        given |= {"split": group, "splits": split}
    whole = windows(dataset, **given)  # refuses a horizon that no episode holds
    return windows(dataset, pad="both", step=int(whole.stride[whole.owner].min()), **given)


def _reads_contact(run: Run) -> bool:
    """Tell whether the model's history holds the hand's contact."""
    return "contact" in find_model(run.model).channels and bool(run.config.get("contact_history", True))


def _contact_from(run: Run, found: Findings) -> str:
    """Return what the closed loop feeds the model as contact."""
    fingertips = bool(run.config.get("fingertip_contact", False))
    if not _reads_contact(run):
        return "recorded" if fingertips else "not read"
    if found.closed_loop[run.model].contact is None:
        return "recorded"
    return "predicted, fingertips recorded" if fingertips else "predicted"


def _seen(kept: checkpoint.Checkpoint, split: Split | None, found: Findings) -> int | None:
    """Return how many of the episodes the model was trained on, by their ids; None where that is not known."""
    train = jobs.trained_on(kept, split)
    return None if train is None else sum(one.id in train for one in found.by_episode)
