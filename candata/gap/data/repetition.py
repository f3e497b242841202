"""Which recordings play the same motion: their commands are alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings

Array = NDArray[np.float64]
#: How far commands of repeated episodes may be apart on average, as a share of their range, and lengths of one another.
#: Chosen: a logger's clock is no better.
ALIKE = 0.01


def repeated_pairs(recs: Recordings) -> list[tuple[int, int]]:
    """Return pairs of episodes in which the same commands were played; a third repeat is paired with the second."""
    spread = np.ptp(recs.commands, axis=(0, 1)) if recs.commands.size else np.zeros(0)
    moving = spread > 0
    pairs: list[tuple[int, int]] = []
    last: list[int] = []
    for i in range(len(recs) if moving.any() else 0):
        same = next((k for k, j in enumerate(last) if _is_repeat(recs, i, j, spread, moving)), None)
        if same is None:
            last.append(i)
        else:
            pairs.append((last[same], i))
            last[same] = i
    return pairs


def repeat_groups(recs: Recordings) -> list[list[int]]:
    """Return the episodes of each motion that was played more than once."""
    groups: list[list[int]] = []
    for first, second in repeated_pairs(recs):
        group = next((g for g in groups if first in g), None)
        if group is None:
            groups.append([first, second])
        else:
            group.append(second)
    return groups


def motion_numbers(recs: Recordings) -> NDArray[np.int64]:
    """Return `(E,)` the number of the motion that each episode plays: repeats of one share theirs."""
    numbers = np.arange(len(recs))
    for group in repeat_groups(recs):
        numbers[group] = group[0]
    return np.unique(numbers, return_inverse=True)[1]


def same_motions(recs: Recordings, reference: Recordings) -> list[list[int]]:
    """Return for each of the recordings the episodes of a reference in which the same commands were played."""
    spread = np.ptp(np.concatenate([r.commands.reshape(-1, r.commands.shape[2]) for r in (recs, reference)]), axis=0)
    moving = spread > 0
    if not moving.any():
        return [[] for _ in range(len(recs))]
    return [
        [j for j in range(len(reference)) if _is_same_motion(recs, i, reference, j, spread, moving)]
        for i in range(len(recs))
    ]


def _is_repeat(recs: Recordings, i: int, j: int, spread: Array, moving: NDArray[np.bool_]) -> bool:
    """Tell whether two episodes are as long and were commanded the same."""
    return _is_same_motion(recs, i, recs, j, spread, moving)


def _is_same_motion(
    recs: Recordings, i: int, others: Recordings, j: int, spread: Array, moving: NDArray[np.bool_]
) -> bool:
    """Tell whether an episode is as long as one of others, and was commanded the same."""
    short, long = sorted((int(recs.lengths[i]), int(others.lengths[j])))
    apart = np.abs(recs.commands[i, :short] - others.commands[j, :short])[:, moving].mean(0)
    return long - short <= ALIKE * long and bool((apart <= ALIKE * spread[moving]).all())
