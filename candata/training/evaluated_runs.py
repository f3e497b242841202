"""The runs of an evaluation: read, named, and refused where they cannot be compared or were trained on the test."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from candata.datasets import Dataset
from candata.errors import UsageError, Where
from candata.loaders import Split, find_split, split_digest, split_names
from candata.models import Model
from candata.models import model as find_model
from candata.schema.channels import CHANNELS
from candata.schema.json_text import parse_json
from candata.training import checkpoint, jobs, runs
from candata.training.checkpoint import Checkpoint
from candata.training.rollout import EXECUTE
from candata.training.settings import Run

#: Groups of a split in which episodes that were trained on are looked for knowingly.
KNOWINGLY_SEEN = ("train", "all")
#: Ids that a message names.
_NAMED_IDS = 5


@dataclass(frozen=True)
class EvaluatedRun:
    """A run to evaluate.

    Attributes
    ----------
    name : str
        What it is called beside the others.
    checkpoint : Checkpoint
        What was read.
    execute : int
        Steps executed before the next forecast in closed loop.
    """

    name: str
    checkpoint: Checkpoint
    execute: int

    @property
    def run(self) -> Run:
        """What its weights mean."""
        return self.checkpoint.run

    @property
    def model(self) -> Model:
        """Its model."""
        return find_model(self.run.model)


def run_names(paths: Sequence[Path], taken: Collection[str] = ()) -> tuple[str, ...]:
    """Return a name for each run: its folder's, of a checkpoint with the file's, longer where two would be equal.

    Parameters
    ----------
    paths : sequence of Path
        Folders of runs, or checkpoints.
    taken : collection of str
        Names that stand for something else.

    Raises
    ------
    UsageError
        When a run is there twice.
    """
    if len(set(places := [path.resolve() for path in paths])) < len(places):
        twice = next(path for path, count in Counter(places).items() if count > 1)
        raise UsageError("a run is named twice", where=Where(path=str(twice)), fix="name each run once")
    parts = [(place.parent / place.stem if place.is_file() else place).parts for place in places]
    shown = [2 if place.is_file() else 1 for place in places]
    while True:
        names = ["/".join(part[-count:]) for part, count in zip(parts, shown, strict=True)]
        counts = Counter([*names, *taken])
        longer = [
            count + 1 if counts[name] > 1 and count < len(part) else count
            for name, part, count in zip(names, parts, shown, strict=True)
        ]
        if longer == shown:
            return tuple(names)
        shown = longer


def read_runs(paths: Sequence[Path], execute: int | None, taken: Collection[str] = ()) -> tuple[EvaluatedRun, ...]:
    """Return the runs, each with its best checkpoint.

    Parameters
    ----------
    paths : sequence of Path
        Folders of runs, or checkpoints.
    execute : int or None
        Steps executed before the next forecast; by default 8, or the horizon where that is shorter.
    taken : collection of str
        Names that stand for something else.

    Raises
    ------
    UsageError
        When there is no checkpoint, it is a pickle, a run is there twice, their rates differ, or a channel has another
        unit now.
    DataError
        When a checkpoint is damaged.
    """
    read = [checkpoint.read(path) for path in paths]
    evaluated = tuple(
        EvaluatedRun(name, each, min(EXECUTE, each.run.sizes["horizon"]) if execute is None else execute)
        for name, each in zip(run_names(paths, taken), read, strict=True)
    )
    for each in evaluated:
        _check_rate(evaluated[0], each)
        _check_units(each)
    return evaluated


def _check_rate(first: EvaluatedRun, other: EvaluatedRun) -> None:
    """Refuse models whose steps are not of one length: no instants could be compared."""
    if other.run.rate_hz != first.run.rate_hz:
        raise UsageError(
            "the runs step at different rates",
            expected=f"{first.run.rate_hz:g} Hz, as {first.name}",
            found=f"{other.run.rate_hz:g} Hz",
            where=Where(path=str(other.checkpoint.path)),
            fix="evaluate them one by one, or train them at one --rate-hz",
        )


def _check_units(evaluated: EvaluatedRun) -> None:
    """Refuse a run whose channels had other units than they have now."""
    for channel, unit in evaluated.run.units.items():
        current_unit = str(CHANNELS[channel].unit) if channel in CHANNELS else unit
        if unit != current_unit:
            raise UsageError(
                "the run was trained in other units",
                expected=f"{channel} in {current_unit}",
                found=f"{channel} in {unit}",
                where=Where(path=str(evaluated.checkpoint.path), channel=channel),
                fix="train a new model on these data",
            )


def check_scaled(evaluated: Sequence[EvaluatedRun], dataset: Dataset, ids: Collection[str]) -> None:
    """Refuse episodes that hold a channel the models read in a unit of their source's.

    Raises
    ------
    UsageError
        Names episode, channel and run.
    """
    read_by = {channel: each.name for each in reversed(evaluated) for channel in each.run.channels}
    catalog = dataset.catalog(["id", "meta"])
    for episode_id, text in zip(catalog["id"].to_pylist(), catalog["meta"].to_pylist(), strict=True):
        unscaled = parse_json(text).get("unscaled") or ()
        channel = next((name for name in unscaled if name in read_by), None)
        if episode_id in ids and channel is not None:
            raise UsageError(
                "the run reads a channel that has another unit here",
                expected=f"{channel} in {CHANNELS[channel].unit}, as {read_by[channel]} was trained on",
                found="a unit of the recording's source",
                where=Where(path=str(dataset.path), episode=episode_id, channel=channel),
                fix="import the recording with the unit of this channel, or evaluate a model that does not read it",
            )


def split_of(evaluated: Sequence[EvaluatedRun], dataset: Dataset) -> tuple[Split, str]:
    """Return the split to evaluate by and its name: the runs' own on their own data, else the one the dataset has.

    Raises
    ------
    UsageError
        When two runs were trained by different splits of the dataset, or a run's split is not kept.
    """
    own = [(each, split) for each in evaluated if (split := _own_split(each, dataset)) is not None]
    if not own:
        stated = evaluated[0].run.split if evaluated else None
        name = stated if stated in split_names(dataset) else None
        return find_split(dataset, name), name or "default"
    first, split = own[0]
    for other, other_split in own[1:]:
        if split_digest(other_split) != split_digest(split):
            raise UsageError(
                "the runs were trained by different splits of the dataset",
                expected=f"the split {first.run.split} of {first.name}",
                found=f"{other.run.split} of {other.name}: no episodes are held out from both",
                where=Where(path=str(other.checkpoint.path)),
                fix="train both by one stored split (--split NAME), or evaluate them one by one",
            )
    return split, first.run.split


def _own_split(evaluated: EvaluatedRun, dataset: Dataset) -> Split | None:
    """Return the split by which a run was trained on this dataset or an earlier version of it; None where it was not.

    What was appended since belongs to none of its groups.
    """
    run, folder = evaluated.run, evaluated.checkpoint.path.parent
    splits, digests = runs.read_splits(folder, run), dataset.digests
    source_index = next((i for i, source in enumerate(run.trained_on) if source.digest in digests), None)
    if source_index is None:
        return None
    if splits is not None:
        return splits[source_index]
    split = find_split(dataset, run.split if run.split in split_names(dataset) else None)
    if split_digest(split) != run.trained_on[source_index].split_digest:
        raise UsageError(
            "the split of the run is not there any more",
            expected=f"{runs.SPLIT} beside the checkpoint",
            found=f"a split {run.split} of other episodes",
            fix="evaluate the run's folder, or another dataset",
        )
    return split


def seen_ids(evaluated: EvaluatedRun, dataset: Dataset, split: Split, ids: Sequence[str]) -> tuple[str, ...] | None:
    """Return those of the ids that a run, or one it began with, was trained on; None where that is not known.

    Episodes are told by their ids alone.
    """
    trained_ids = jobs.trained_on(evaluated.checkpoint, split if evaluated.run.digest == dataset.digest else None)
    return None if trained_ids is None else tuple(name for name in ids if name in trained_ids)


def refuse_seen(evaluated: EvaluatedRun, seen: Sequence[str], group: str) -> None:
    """Refuse test episodes that a run was trained on.

    Raises
    ------
    UsageError
        Names the first of them.
    """
    if not seen or group in KNOWINGLY_SEEN:
        return
    more = f" and {len(seen) - _NAMED_IDS} more" if len(seen) > _NAMED_IDS else ""
    raise UsageError(
        f"{evaluated.name} was trained on episodes of the group {group}",
        expected="test episodes that neither the run nor one it began with has seen",
        found=f"{len(seen)} seen: {', '.join(seen[:_NAMED_IDS])}{more}",
        where=Where(path=str(evaluated.checkpoint.path)),
        fix="evaluate by a split whose test episodes it has not seen; or, if these are other episodes that happen to "
        "have the same ids, or to score it on what it has seen, give --split all",
    )
