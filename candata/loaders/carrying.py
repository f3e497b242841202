"""Stored splits carried to a dataset made of others: each episode stays in its group, or a note says why.

A split is a list of episodes by name, drawn once. Drawing it anew over other episodes would put some that trained a
model into its test. So a subset keeps who was in which group, and several datasets give one split only where all
of them store it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from candata.datasets import Dataset, open_dataset
from candata.loaders.splits import GROUPS, Split, load_split, save_split, split_names

#: Episode to its group in one parent.
_GroupByEpisode = Mapping[str, str]


def carry_splits(
    parents: Sequence[Dataset], note: Callable[[str], None], prefix: bool = False
) -> Callable[[Path], None]:
    """Return what stores in a new dataset the splits of those that it was made of.

    One parent: each of its splits, less the episodes that are not there. Several: the splits of a name that all of
    them store, where they name every episode and none contradicts another. A split drawn `by` a field must still
    keep together what agrees in it. `note` takes a line for each split that lost a group or was not carried.

    Parameters
    ----------
    parents : sequence of Dataset
        What it was made of.
    note : callable
        Takes lines for people.
    prefix : bool
        Ids in the new dataset are `NAME-ID`.
    """

    def carry(root: Path) -> None:
        dataset = open_dataset(root)
        for name in sorted({name for parent in parents for name in split_names(parent)}):
            split = _carry_split(parents, dataset, name, prefix)
            if isinstance(split, str):
                note(f"the split {name} is not carried: {split}; `candata registry split` draws a new one")
                continue
            save_split(dataset, split, name)
            empty_groups = [g for g in GROUPS if split.fractions[g] and not split.ids(g)]
            counts = ", ".join(f"{group} {len(split.ids(group))}" for group in GROUPS)
            note(
                f"the split {name} is carried: {counts}{'; empty now: ' * bool(empty_groups)}{', '.join(empty_groups)}"
            )

    return carry


def _carry_split(parents: Sequence[Dataset], dataset: Dataset, name: str, prefix: bool) -> Split | str:
    """Return the split of the new dataset; else why there is none."""
    parents_without_split = [parent.name for parent in parents if name not in split_names(parent)]
    if parents_without_split:
        verb = "has" if len(parents_without_split) == 1 else "have"
        return f"{', '.join(parents_without_split)} {verb} none of that name"
    splits = [load_split(parent, name) for parent in parents]
    groups: dict[str, str] = {}
    for group_of in (
        _group_by_episode(split, f"{parent.name}-" * prefix) for parent, split in zip(parents, splits, strict=True)
    ):
        for episode in group_of.keys() & dataset.places.keys():
            if groups.setdefault(episode, group_of[episode]) != group_of[episode]:
                return f"{episode} is in {group_of[episode]} of one and in {groups[episode]} of another"
    ids_without_group = [episode for episode in dataset.ids if episode not in groups]
    if not groups or (ids_without_group and len(parents) > 1):
        count, example = len(ids_without_group), ids_without_group[0]
        return f"{count} of {len(dataset)} episodes are in none of its groups, such as {example}"
    ids_by_group = {group: tuple(sorted(e for e, g in groups.items() if g == group)) for group in GROUPS}
    split = _join_splits(parents, splits, ids_by_group)
    divided_value = next(_divided_values(dataset, split, groups), None)
    return split if divided_value is None else f"{split.by} {divided_value} would be in two of its groups"


def _group_by_episode(split: Split, prefix: str) -> _GroupByEpisode:
    """Return the group of each episode of a split."""
    return {f"{prefix}{episode}": group for group in GROUPS for episode in split.ids(group)}


def _join_splits(
    parents: Sequence[Dataset], splits: Sequence[Split], ids_by_group: Mapping[str, tuple[str, ...]]
) -> Split:
    """Return the split of these groups; of several splits, each fact of the draw in which they agree."""
    first_split = splits[0]
    if len(splits) == 1:
        return first_split.model_copy(update=ids_by_group)
    total = sum(map(len, ids_by_group.values()))
    return Split(
        dataset="+".join(split.dataset for split in splits),
        digest="+".join(split.digest for split in splits),
        seed=first_split.seed if all(split.seed == first_split.seed for split in splits) else None,
        by=first_split.by if all(split.by == first_split.by for split in splits) else None,
        fractions={group: len(ids) / total for group, ids in ids_by_group.items()},
        **ids_by_group,
    )


def _divided_values(dataset: Dataset, split: Split, groups: _GroupByEpisode) -> Iterator[str]:
    """Yield values of the field a split was drawn by that are in two groups."""
    if split.by is None:
        return
    group_by_value: dict[str, str] = {}
    for episode, value in zip(dataset.ids, dataset.catalog([split.by])[split.by].to_pylist(), strict=True):
        if episode in groups and group_by_value.setdefault(value, groups[episode]) != groups[episode]:
            yield str(value)
