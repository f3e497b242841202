"""Sets of an experiment that stand: found, and refused where a model lacks a channel or would see a test episode."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from candata.datasets import Dataset, open_dataset
from candata.datasets.registry import resolve
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.experiment.config import Column, ExperimentFile, ModelEntry
from candata.experiment.sources import part_ids
from candata.loaders.layout import row_shapes
from candata.models import Model
from candata.models import model as find_model
from candata.training.jobs import OF_THE_ROBOT

#: Said where a standing set lacks a channel that a model reads.
NO_PUBLIC_SET = "no public set has poses, joints, commands and tip forces together"
#: Ids that a message names.
NAMED_IDS = 5


def standing_set(file: ExperimentFile, source_name: str) -> Dataset:
    """Return a set that stands.

    Raises
    ------
    DataError
        When there is none.
    """
    path = str(file.data[source_name].path)
    if not Path(path).exists() and not Path(path).name.startswith("@"):
        raise DataError(
            f"the set {source_name} is not there",
            expected="a dataset",
            where=Where(path=path),
            fix="candata fetch gets public sets; see candata fetch --help",
        )
    folder, version = resolve(path)
    return open_dataset(folder, version)


def check_channels(file: ExperimentFile, title: str, column: Column) -> None:
    """Refuse models that cannot be configured, and a standing real set that lacks a channel that one reads."""
    for name, entry in file.models.items():
        configured(find_model(entry.model or name), entry, 0)
    if file.data[column.real].path is None:
        return
    present = set(row_shapes(standing_set(file, column.real), None))
    for name, entry in file.models.items():
        missing = [c for c in reads(entry, name) if c not in present and c not in OF_THE_ROBOT]
        if missing:
            raise DataError(
                f"column {title}: {column.real} lacks {', '.join(missing)}, which {name} reads",
                expected=", ".join(reads(entry, name)),
                found=f"{', '.join(sorted(present))}; {NO_PUBLIC_SET}",
                where=Where(path=str(file.data[column.real].path)),
                fix=f"leave {name} out of this experiment, or record the channel",
            )


def check_unseen(file: ExperimentFile, title: str, column: Column) -> None:
    """Refuse standing sets whose training episodes are test episodes of the column, by their content."""
    if file.data[column.real].path is None:
        return
    test = _content(file, column.real, file.data[column.real].split, "test")
    # Pre-training is by the default split, whatever the split of a real part.
    splits: dict[str | None, str | None] = {column.sim: None, column.larger: None}
    if column.diagnosed is not None:
        splits[column.diagnosed] = file.data[column.diagnosed].split
    for name, split in splits.items():
        if name is None or file.data[name].path is None:
            continue
        seen = sorted(test[content] for content in test.keys() & _content(file, name, split, "train-all").keys())
        if seen:
            raise UsageError(
                f"column {title}: {name} would train or repair on test episodes of {column.real}",
                expected="no test episode among those that are trained on or diagnosed",
                found=f"{len(seen)} seen: {', '.join(seen[:NAMED_IDS])}{' and more' * (len(seen) > NAMED_IDS)}",
                where=Where(path=str(file.data[name].path)),
                fix="hold the same episodes out of both, by one stored split",
            )


def _content(file: ExperimentFile, source_name: str, split: str | None, part: str) -> dict[str, str]:
    """Return the ids of a part of a standing set by the hash of what the episode holds."""
    dataset = standing_set(file, source_name)
    catalog = dataset.catalog(["id", "content_hash"])
    hashes = dict(zip(catalog["id"].to_pylist(), catalog["content_hash"].to_pylist(), strict=True))
    ids = part_ids(dataset, {"part": part, "split": split})
    return {hashes[name]: name for name in ids}


def reads(entry: ModelEntry, name: str) -> tuple[str, ...]:
    """Return the channels that a model of an experiment reads."""
    model = find_model(entry.model or name)
    return model.reads(configured(model, entry, 0))


def configured(model: Model, entry: ModelEntry, seed: int) -> Any:
    """Return the configuration of a model of an experiment.

    Raises
    ------
    UnknownNameError
        When it has no such preset.
    """
    if entry.preset not in model.presets:
        raise UnknownNameError("preset", entry.preset, model.presets)
    return model.parse(model.presets[entry.preset].model_dump() | {"seed": seed} | entry.config)
