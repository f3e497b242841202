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
from candata.training.forecasters import BASELINES, Forecaster, TrainedModel
from candata.training.results import Evaluation, Scores, Track
from candata.training.scoring import EvaluationFindings, chosen_windows, score
from candata.training.settings import Run

#: Steps of a chunk in closed loop, half the default horizon.
EXECUTE = 8


@dataclass(frozen=True)
class EvaluationSettings:
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
    path: Path, dataset: Dataset, settings: EvaluationSettings, stage: Callable[[str], None] = lambda _name: None
) -> tuple[Evaluation, tuple[Track, ...]]:
    """Return what was found, and a few episodes for the figures.

    Parameters
    ----------
    path : Path
        Folder of a run (its best checkpoint), or a checkpoint.
    dataset : Dataset
        Version to evaluate on.
    settings : EvaluationSettings
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
    checkpoint_read = checkpoint.read(path)
    run = checkpoint_read.run
    execute = settings.execute if settings.execute is not None else min(EXECUTE, run.sizes["horizon"])
    _check(settings, execute, run)
    jobs.check_device(settings.device)
    split, name = split_of(checkpoint_read.path.parent, run, dataset)
    stage("reading the dataset")
    held_out_windows = _windows(dataset, split, run, settings.group)
    jobs.check_data(checkpoint_read, held_out_windows)
    model = TrainedModel(
        jobs.trained_module(checkpoint_read, settings.device),
        feed.clouds_of(held_out_windows, settings.device),
        settings.samples,
        settings.steps,
        settings.device,
        f"the model ({run.model}, mean of {settings.samples} samples)",
    )
    forecasters: dict[str, Forecaster] = {run.model: model, **BASELINES}
    findings = score(held_out_windows, forecasters, execute, settings.seed, stage)
    seen_episodes = _seen_count(checkpoint_read, split if run.digest == dataset.digest else None, findings)
    return Evaluation(
        run=path.name,
        checkpoint=checkpoint_read.path.name,
        step=checkpoint_read.progress.step,
        model=run.model,
        trained_on=f"{run.dataset}@{run.digest[:12]}",
        dataset=f"{dataset.name}@{dataset.digest[:12]}",
        split=name,
        group=settings.group,
        seen_episodes=seen_episodes,
        episodes=len(findings.by_episode),
        windows=len(chosen_windows(held_out_windows)),
        rows=findings.rows,
        rate_hz=run.rate_hz,
        history=run.sizes["history"],
        horizon=run.sizes["horizon"],
        samples=settings.samples,
        sampling_steps=settings.steps,
        execute=execute,
        seed=settings.seed,
        contact_from=_contact_from(run, findings),
        gain=findings.gain,
        by_episode=findings.by_episode,
        forecasters={
            key: Scores(
                summary=forecaster.summary, windows=findings.windows[key], closed_loop=findings.closed_loop[key]
            )
            for key, forecaster in forecasters.items()
        },
        revision=__version__,
    ), findings.tracks


def _check(settings: EvaluationSettings, execute: int, run: Run) -> None:
    """Refuse numbers that mean nothing."""
    group_names = (*GROUPS, "all")
    if settings.group not in group_names:
        raise UnknownNameError("group of a split", settings.group, group_names)
    for name, value, maximum in (
        ("samples", settings.samples, None),
        ("steps", settings.steps, run.config.get("train_steps")),
        ("execute", execute, run.sizes["horizon"]),
    ):
        if value < 1 or (maximum is not None and value > maximum):
            raise UsageError(
                f"--{name} is out of range", expected=f"1 to {maximum}" if maximum else "at least 1", found=str(value)
            )


def split_of(folder: Path, run: Run, dataset: Dataset) -> tuple[Split, str]:
    """Return the split to evaluate by and its name: the run's own on its own data, else the one the dataset has."""
    splits = runs.read_splits(folder, run)
    source_index = next((i for i, source in enumerate(run.trained_on) if source.digest == dataset.digest), None)
    if source_index is not None and splits is not None:
        return splits[source_index], run.split
    name = run.split if run.split in split_names(dataset) else None
    split = find_split(dataset, name)
    if source_index is not None and split_digest(split) != run.trained_on[source_index].split_digest:
        raise UsageError(
            "the split of the run is not there any more",
            expected=f"{runs.SPLIT} beside the checkpoint",
            found=f"a split {run.split} of other episodes",
            fix="evaluate the run's folder, or another dataset",
        )
    return split, name or "default"


def _windows(dataset: Dataset, split: Split, run: Run, group: str) -> Windows:
    """Return a window at every step of the model."""
    options: dict[str, Any] = {
        "history": run.sizes["history"],
        "horizon": run.sizes["horizon"],
        "rate_hz": run.rate_hz,
        "channels": channels_for(run.channels, dataset),
    }
    if group != "all":
        options |= {"split": group, "splits": split}
    full_windows = windows(dataset, **options)  # refuses a horizon that no episode holds
    return windows(dataset, pad="both", step=int(full_windows.stride[full_windows.owner].min()), **options)


def _reads_contact(run: Run) -> bool:
    """Tell whether the model's history holds the hand's contact."""
    return "contact" in find_model(run.model).channels and bool(run.config.get("contact_history", True))


def _contact_from(run: Run, findings: EvaluationFindings) -> str:
    """Return what the closed loop feeds the model as contact."""
    fingertips = bool(run.config.get("fingertip_contact", False))
    if not _reads_contact(run):
        return "recorded" if fingertips else "not read"
    if findings.closed_loop[run.model].contact is None:
        return "recorded"
    return "predicted, fingertips recorded" if fingertips else "predicted"


def _seen_count(
    checkpoint_read: checkpoint.Checkpoint, split: Split | None, findings: EvaluationFindings
) -> int | None:
    """Return how many of the episodes the model was trained on, by their ids; None where that is not known."""
    train = jobs.trained_on(checkpoint_read, split)
    return None if train is None else sum(scores.id in train for scores in findings.by_episode)
