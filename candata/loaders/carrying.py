"""What becomes of stored splits when a dataset is made of others: each episode stays in its group, or it is said why.

A split is a list of episodes by name, drawn once; drawing it anew over other episodes would put some that trained a
model into its test. So a subset keeps who was where, and several datasets give one split only where all tell.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from candata.datasets import Dataset, open_dataset
from candata.loaders.splits import GROUPS, Split, load_split, save_split, split_names

#: Episode to group, as one parent tells.
_Told = Mapping[str, str]


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
        made = open_dataset(root)
        for name in sorted({name for parent in parents for name in split_names(parent)}):
            split = _carried(parents, made, name, prefix)
            if isinstance(split, str):
                note(f"the split {name} is not carried: {split}; `candata registry split` draws a new one")
                continue
            save_split(made, split, name)
            emptied = [g for g in GROUPS if split.fractions[g] and not split.ids(g)]
            counts = ", ".join(f"{group} {len(split.ids(group))}" for group in GROUPS)
            note(f"the split {name} is carried: {counts}{'; empty now: ' * bool(emptied)}{', '.join(emptied)}")

    return carry


def _carried(parents: Sequence[Dataset], made: Dataset, name: str, prefix: bool) -> Split | str:
    """Return the split of the new dataset; else why there is none."""
    lacking = [parent.name for parent in parents if name not in split_names(parent)]
    if lacking:
        return f"{', '.join(lacking)} {'has' if len(lacking) == 1 else 'have'} none of that name"
    splits = [load_split(parent, name) for parent in parents]
    groups: dict[str, str] = {}
    for told in (_told(split, f"{parent.name}-" * prefix) for parent, split in zip(parents, splits, strict=True)):
        for episode in told.keys() & made.places.keys():
            if groups.setdefault(episode, told[episode]) != told[episode]:
                return f"{episode} is in {told[episode]} of one and in {groups[episode]} of another"
    uncovered = [episode for episode in made.ids if episode not in groups]
    if not groups or (uncovered and len(parents) > 1):
        return f"{len(uncovered)} of {len(made)} episodes are in none of its groups, such as {uncovered[0]}"
    kept = {group: tuple(sorted(e for e, g in groups.items() if g == group)) for group in GROUPS}
    split = _joined(parents, splits, kept)
    torn = next(_torn(made, split, groups), None)
    return split if torn is None else f"{split.by} {torn} would be in two of its groups"


def _told(split: Split, prefix: str) -> _Told:
    """Return the group of each episode of a split."""
    return {f"{prefix}{episode}": group for group in GROUPS for episode in split.ids(group)}


def _joined(parents: Sequence[Dataset], splits: Sequence[Split], kept: Mapping[str, tuple[str, ...]]) -> Split:
    """Return the split of these groups; of several splits, each fact of the draw in which they agree."""
    first = splits[0]
    if len(splits) == 1:
        return first.model_copy(update=kept)
    total = sum(map(len, kept.values()))
    return Split(
        dataset="+".join(split.dataset for split in splits),
        digest="+".join(split.digest for split in splits),
        seed=first.seed if all(split.seed == first.seed for split in splits) else None,
        by=first.by if all(split.by == first.by for split in splits) else None,
        fractions={group: len(ids) / total for group, ids in kept.items()},
        **kept,
    )


def _torn(made: Dataset, split: Split, groups: _Told) -> Iterator[str]:
    """Yield values of the field a split was drawn by that are in two groups."""
    if split.by is None:
        return
    seen: dict[str, str] = {}
    for episode, value in zip(made.ids, made.catalog([split.by])[split.by].to_pylist(), strict=True):
        if episode in groups and seen.setdefault(value, groups[episode]) != groups[episode]:
            yield str(value)
