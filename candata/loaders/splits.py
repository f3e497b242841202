"""Splits: which episodes train, validate and test; never rows of one episode in two of them."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from candata.datasets import Dataset, durable
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.schema.record import Record

GROUPS = ("train", "val", "test")

#: Shares of the episodes when none are given.
FRACTIONS: Mapping[str, float] = {"train": 0.8, "val": 0.1, "test": 0.1}

#: Name under which a split is looked for when none is given.
DEFAULT = "default"

SplitField = Literal["object", "scene", "task", "source"]


class Split(Record):
    """`splits/NAME.json`: episode ids of each group, and how they were drawn.

    `dataset` and `digest` name the version it was drawn from, or with `+` those whose splits were joined; `by` is the
    field whose values were kept together. `seed` is None where joined splits had several.
    """

    dataset: str
    digest: str
    seed: int | None
    by: SplitField | None = None
    fractions: dict[str, float]
    train: tuple[str, ...]
    val: tuple[str, ...]
    test: tuple[str, ...]

    def ids(self, group: str) -> tuple[str, ...]:
        """Return the episode ids of `train`, `val` or `test`.

        Raises
        ------
        UnknownNameError
            When there is no such group.
        """
        if group not in GROUPS:
            raise UnknownNameError("group of a split", group, GROUPS)
        episode_ids: tuple[str, ...] = getattr(self, group)
        return episode_ids


def make_split(
    dataset: Dataset, fractions: Mapping[str, float] = FRACTIONS, seed: int = 0, by: SplitField | None = None
) -> Split:
    """Return a split of the dataset's episodes, the same for a seed and a set of ids.

    Episodes (or groups of them, with `by`) are taken in the order of sha256(seed, name); each goes to the
    group that is furthest below its share. Every group with a share gets at least one.

    Parameters
    ----------
    dataset : Dataset
        Version to split.
    fractions : mapping of str to float
        Shares of `train`, `val`, `test`; they add up to 1, one left out is 0.
    seed : int
        Seed of the draw.
    by : str, optional
        `object`, `scene`, `task` or `source`: episodes that agree in it stay together.

    Raises
    ------
    UsageError
        When the shares do not add up to 1 or are negative.
    UnknownNameError
        When a share or `by` has another name.
    DataError
        When there are fewer episodes (or groups) than groups to fill, or an episode does not state `by`.
    """
    shares = _complete_shares(fractions)
    bundles = _bundles(dataset, by)
    groups = [name for name in GROUPS if shares[name] > 0]
    if len(bundles) < len(groups):
        raise DataError(
            "too few episodes to split",
            expected=f"at least {len(groups)} {'episodes' if by is None else by + 's'}: {', '.join(groups)}",
            found=str(len(bundles)),
            where=Where(path=str(dataset.path)),
            fix="add episodes, or give fewer groups a share",
        )
    order = sorted(bundles, key=lambda name: hashlib.sha256(f"{seed}|{name}".encode()).digest())
    bundles_by_group = _assign(order, {name: len(bundles[name]) for name in order}, {n: shares[n] for n in groups})
    ids = {
        group: tuple(sorted(i for name in names for i in bundles[name])) for group, names in bundles_by_group.items()
    }
    return Split(
        dataset=dataset.name,
        digest=dataset.digest,
        seed=seed,
        by=by,
        fractions=shares,
        **{group: ids.get(group, ()) for group in GROUPS},
    )


def _complete_shares(fractions: Mapping[str, float]) -> dict[str, float]:
    """Return the three shares."""
    for name in fractions:
        if name not in GROUPS:
            raise UnknownNameError("group of a split", name, GROUPS)
    shares = {name: float(fractions.get(name, 0.0)) for name in GROUPS}
    if not (min(shares.values()) >= 0 and math.isclose(sum(shares.values()), 1, abs_tol=1e-6)):
        raise UsageError("the shares of a split must not be negative and add up to 1", found=str(shares))
    return shares


def _bundles(dataset: Dataset, field: SplitField | None) -> dict[str, list[str]]:
    """Return what must stay together: bundle name to episode ids."""
    if field is None:
        return {name: [name] for name in dataset.ids}
    if field not in ("object", "scene", "task", "source"):
        raise UnknownNameError("field to split by", field, ("object", "scene", "task", "source"))
    bundles: dict[str, list[str]] = {}
    for name, value in zip(dataset.ids, dataset.catalog()[field].to_pylist(), strict=True):
        if value is None:
            raise DataError(
                f"an episode does not state its {field}",
                where=Where(path=str(dataset.path), episode=name),
                fix="split by another field, or by episode",
            )
        bundles.setdefault(value, []).append(name)
    return bundles


def _assign(order: list[str], sizes: dict[str, int], shares: dict[str, float]) -> dict[str, list[str]]:
    """Return group to bundles: each to the group furthest below its share; none stays empty."""
    total = sum(sizes.values())
    shortfall = {group: share * total for group, share in shares.items()}
    bundles_by_group: dict[str, list[str]] = {group: [] for group in shares}
    for name in order:
        group = max(shortfall, key=lambda g: shortfall[g])
        bundles_by_group[group].append(name)
        shortfall[group] -= sizes[name]
    for group in [g for g, names in bundles_by_group.items() if not names]:
        richest = max(bundles_by_group, key=lambda g: len(bundles_by_group[g]))
        bundles_by_group[group].append(bundles_by_group[richest].pop())
    return bundles_by_group


def save_split(dataset: Dataset, split: Split, name: str = DEFAULT) -> Path:
    """Return `splits/NAME.json` in the dataset, written once; the same split may be saved again.

    Raises
    ------
    UsageError
        When another split has this name, or the name cannot be a file's.
    """
    path = _path(dataset, name)
    data = durable.encode_record(split)
    if not durable.create_once(dataset.path, path, data) and durable.read_record(Split, path) != split:
        raise UsageError(
            f"another split is called {name}",
            where=Where(path=str(path)),
            fix="choose another name: a split that models were trained on must not change",
        )
    return path


def load_split(dataset: Dataset, name: str = DEFAULT) -> Split:
    """Return the split that is stored in the dataset under `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    DataError
        When the file is damaged.
    """
    path = _path(dataset, name)
    if not path.is_file():
        raise UnknownNameError("split", name, split_names(dataset), Where(path=str(dataset.path)))
    return durable.read_record(Split, path)


def split_names(dataset: Dataset) -> tuple[str, ...]:
    """Return the names of the splits that are stored in the dataset, sorted."""
    return tuple(sorted(path.stem for path in (dataset.path / "splits").glob("*.json")))


def find_split(dataset: Dataset, split: Split | str | None = None) -> Split:
    """Return a split: the value itself, the stored one of that name, or the default.

    The default is the stored split `default`, or where there is none 80, 10 and 10 percent by episode, seed 0.

    Raises
    ------
    UnknownNameError
        When no split has that name.
    """
    if isinstance(split, Split):
        return split
    if split is not None or DEFAULT in split_names(dataset):
        return load_split(dataset, split or DEFAULT)
    return make_split(dataset)


def group_ids(dataset: Dataset, split: Split, group: str) -> tuple[str, ...]:
    """Return the episode ids of a group, all of which the dataset must hold.

    Raises
    ------
    DataError
        When the group is empty, or names episodes that this version lacks.
    """
    ids = split.ids(group)
    location = Where(path=str(dataset.path))
    if not ids:
        group_sizes = ", ".join(f"{name} {len(split.ids(name))}" for name in GROUPS)
        raise DataError(
            f"the group {group} of the split is empty",
            expected="at least 1 episode",
            found=group_sizes,
            where=location,
            fix=f"make a split that gives {group} a share",
        )
    missing_ids = [name for name in ids if name not in dataset.places]
    if missing_ids:
        raise DataError(
            "the split is of another dataset or version",
            expected=f"episodes of {split.dataset}@{split.digest[:12]}",
            found=f"{dataset.name}@{dataset.digest[:12]}, which lacks {len(missing_ids)} of {len(ids)}: "
            f"{missing_ids[0]}, ...",
            where=location,
            fix="open that version, or make a split of this one",
        )
    return ids


def _path(dataset: Dataset, name: str) -> Path:
    """Return the file of a split."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
        raise UsageError("not a name for a split", expected="letters, digits, - _ .", found=repr(name))
    return dataset.path / "splits" / f"{name}.json"


def split_digest(split: Split) -> str:
    """Return the sha256 of who is in which group: what a checkpoint keeps of its split."""
    groups = {name: split.ids(name) for name in GROUPS}
    return hashlib.sha256(json.dumps(groups, sort_keys=True).encode()).hexdigest()
