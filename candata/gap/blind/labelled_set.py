"""A set of labelled real recordings: its settings, what was changed between them, and the pairs to compare."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path
from typing import NamedTuple

from candata.datasets import Dataset, open_dataset
from candata.datasets.registry import resolve
from candata.effects import effect_names
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.gap.data.supply import CHANNEL
from candata.schema.labelled import LabelledSetFile
from candata.schema.yaml_text import read_yaml

LABELS = "labels.yaml"


class Pair(NamedTuple):
    """Two settings to compare: their names, what was changed (None for a null) and the ratio of the labels."""

    a: str
    b: str
    label: str | None
    ratio: float | None


class LabelledSet(NamedTuple):
    """A labelled set, read: the file, its recordings, the labels of each setting, and the ids of its episodes."""

    folder: Path
    file: LabelledSetFile
    dataset: Dataset
    labels: dict[str, dict[str, str]]
    episodes: dict[str, tuple[str, ...]]

    @property
    def scene(self) -> str:
        """What `load_scene` takes."""
        path = self.folder / self.file.scene
        return str(path) if path.exists() else self.file.scene

    @property
    def effects(self) -> str | None:
        """File of the effects that the scene holds already."""
        return None if self.file.effects is None else str(self.folder / self.file.effects)


def read_labelled(folder: Path, dataset: str | None = None) -> LabelledSet:
    """Return the labelled set of a folder, of its own recordings or of a dataset's folder or registered name.

    Raises
    ------
    UsageError, DataError, UnknownNameError
        When `labels.yaml` or the table is missing or wrong, when a label names nothing, or an episode is not there.
    """
    path = folder / LABELS
    if not path.is_file():
        raise UsageError(
            "no labelled set", expected=f"{LABELS} in the folder", where=Where(path=str(folder)), fix="see the docs"
        )
    file = LabelledSetFile.parse(read_yaml(path), path)
    for label, cause in file.causes.items():
        for name in cause.effects:
            if name not in effect_names((CHANNEL,)):
                raise UnknownNameError(f"effect of the label {label}", name, effect_names((CHANNEL,)))
    recordings = _recordings(folder, file, dataset)
    columns = [*file.causes, *([file.same] if file.same else [])]
    rows = (
        _labels_of(recordings, columns)
        if file.settings is None
        else _table(folder / file.settings, recordings, columns)
    )
    labels: dict[str, dict[str, str]] = {}
    episodes: dict[str, tuple[str, ...]] = {}
    for episode, row in rows.items():
        name = "_".join(f"{label}-{row[label]}" for label in file.causes)
        labels[name] = row
        episodes[name] = (*episodes.get(name, ()), episode)
    return LabelledSet(folder, file, recordings, labels, episodes)


def _recordings(folder: Path, file: LabelledSetFile, dataset: str | None) -> Dataset:
    """Return the dataset that the command names, else the file: a folder beside it, or a registered name."""
    if dataset is None and file.dataset is None:
        raise UsageError(
            "no recordings", expected=f"--dataset, or `dataset` in {LABELS}", where=Where(path=str(folder))
        )
    name = dataset or (str(folder / str(file.dataset)) if (folder / str(file.dataset)).exists() else str(file.dataset))
    path, version = resolve(name)
    return open_dataset(path, version)


def _labels_of(dataset: Dataset, columns: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the labels of each episode as the dataset keeps them."""
    rows = {}
    for episode in dataset.episodes():
        for name in columns:
            if name not in episode.meta.labels:
                raise DataError(
                    f"an episode has no label {name}",
                    expected=", ".join(columns),
                    found=", ".join(episode.meta.labels) or "no labels",
                    where=Where(path=str(dataset.path), episode=episode.meta.id),
                    fix="give a table of settings, or take the label out of `causes`",
                )
        rows[episode.meta.id] = {name: str(episode.meta.labels[name]) for name in columns}
    return rows


def _table(path: Path, dataset: Dataset, columns: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the labels of each episode from a CSV file."""
    wanted = ["episode", *columns]
    rows = _rows(path)
    for name in wanted:
        if name not in rows[0]:
            raise DataError(
                f"the table of settings has no column {name}",
                expected=", ".join(wanted),
                found=", ".join(rows[0]),
                where=Where(path=str(path)),
                fix="add the column, or take the label out of `causes`",
            )
    for number, row in enumerate(rows, 2):
        if row["episode"] not in dataset.ids:
            raise DataError(
                "the table names an episode that is not in the dataset",
                found=row["episode"],
                expected=f"one of {len(dataset.ids)} ids",
                where=Where(path=str(path), index=number),
            )
    return {row["episode"]: {name: row[name] for name in columns} for row in rows}


def _rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError) as fault:
        raise UsageError(
            "the table of settings cannot be read", found=str(fault), where=Where(path=str(path))
        ) from fault
    if not rows:
        raise DataError(
            "the table of settings is empty", expected="a row for each episode", where=Where(path=str(path))
        )
    return rows


def pairs_of(labelled: LabelledSet) -> list[Pair]:
    """Return all ordered pairs of settings that differ in one label, and as nulls the halves of what was repeated."""
    file, pairs = labelled.file, []
    for a, b in permutations(labelled.labels, 2):
        old, new = labelled.labels[a], labelled.labels[b]
        differing = [label for label in file.causes if old[label] != new[label]]
        if len(differing) == 1:
            label = differing[0]
            is_same = file.same is not None and old[file.same] == new[file.same] != ""
            is_null = is_same or not file.causes[label].effects
            pairs.append(Pair(a, b, None if is_null else label, _ratio(old[label], new[label])))
    tasks = dict(zip(*labelled.dataset.catalog(["id", "task"]).to_pydict().values(), strict=True))
    repeated = [n for n, ids in labelled.episodes.items() if len({tasks[i] for i in ids}) < len(ids)]
    return [*pairs, *(Pair(f"{name}.first", f"{name}.second", None, None) for name in repeated)]


def _ratio(old: str, new: str) -> float | None:
    """Return the ratio of two labels; None where they are no numbers other than zero."""
    try:
        return float(new) / float(old)
    except (ValueError, ZeroDivisionError):
        return None
