"""Commands or joints in another order than the scene's, in all episodes or in some."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from candata.gap.data.lag import lag_moments
from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.commands import Paired
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.mismatch.tracking import ZERO_RAD

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: By how much the squared error must fall, as the mean of its logarithm over episodes, before a replay is asked
#: whether a command is another joint's: little, as the replay decides.
SWAP_GAIN = 1.3
#: By how much an exchange must bring the scene's joints closer to the recorded ones to be sure.
CLOSER = 0.5
#: Share of its difference to the scene's joint that an exchange leaves of a joint that tells clearly, and how many such
#: joints decide for those that contact keeps from telling. Chosen: no effect drawn on ten scenes came near.
CLEAR, CLEAR_JOINTS = 0.1, 2
#: Episodes that must ask for the same exchange where the others do not.
AT_LEAST = 2


@dataclass(frozen=True)
class Swap:
    """An exchange that a replay confirms.

    Attributes
    ----------
    chosen : (S,) int64
        Whose command each joint follows.
    channels : str
        `action`, `joint_position`, or both where they cannot be told apart.
    episodes : tuple of bool
        Where it holds; all True where no episode speaks against it.
    errors : (float, float)
        Usual difference of the joints that it moves to the scene's, with it and as given [rad or m].
    """

    chosen: Index
    channels: tuple[str, ...]
    episodes: tuple[bool, ...]
    errors: tuple[float, float]


def swaps(p: Paired) -> list[Index]:
    """Return exchanges `(S,)` that are worth a replay: which command each joint may follow instead of its own.

    First that of all episodes together as a whole, then its cycles, then those that several ask for. A cost is the log
    squared error, mean over episodes: those in which contact stops the fingers tell little, and weigh little.
    """
    costs = np.stack([_cost(p, e) for e in range(len(p.joint))])
    asked = Counter(c for cost in costs for c in _asked(cost))
    often = [c for c, count in asked.most_common() if count >= AT_LEAST]
    together = _asked(costs.mean(0))
    return [np.array(c) for c in dict.fromkeys([*_whole(together), *together, *often])]


def _whole(parts: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """Return the one exchange that disjoint exchanges make; nothing without any."""
    return [tuple(next((x for x in same if x != i), i) for i, same in enumerate(zip(*parts, strict=True)))] * bool(
        parts
    )


def overlap(one: Index, other: Index) -> bool:
    """Tell whether two exchanges move a joint both."""
    straight = np.arange(len(one))
    return bool(((one != straight) & (other != straight)).any())


def _asked(cost: Array) -> list[tuple[int, ...]]:
    """Return the assignment of commands to joints with the least sum of costs (Kuhn 1955), one for each cycle."""
    _, chosen = linear_sum_assignment(cost + np.log(SWAP_GAIN) * (1 - np.eye(len(cost))))
    return [some_of(chosen, cycle) for cycle in cycles(chosen)]


def _cost(p: Paired, episode: int) -> Array:
    """Return `(S, S)` the log squared error of each joint with each command in one episode, at its best lag."""
    found = lag_moments(p.joint[episode : episode + 1], p.target[episode : episode + 1], p.moments.lags)
    away = np.abs(found.mean_q[:, :, None] - found.mean_u)
    error = (found.error() + np.maximum(away - ZERO_RAD, 0) ** 2).min(0)
    # A joint that was not seen has no say.
    return np.where(found.count[0][:, None] > 0, np.log(np.maximum(error, 0) + p.quiet[:, None] ** 2 + 1e-8), 0.0)


def ordered(values: Array, chosen: Index) -> Array:
    """Return values `(..., S)` in the order of the joints, if their columns hold what an exchange says."""
    out = np.empty_like(values)
    out[..., chosen] = values
    return out


def confirmed(p: Paired, chosen: Index, own: Array, commanded: Array, renamed: Array) -> Swap | None:
    """Return the exchange where it brings the scene's joints closer to the recorded ones, each of them.

    Beside a dead joint, a small one that is asked to go far stops at its range: both together would come closer. Where
    fingers hold something, a replay soon lets it go: joints that are free decide for them, if they fit closely.

    Parameters
    ----------
    chosen : (S,) int64
        The exchange.
    own, commanded, renamed : (E, T, S) float64
        Where the scene's joints go as recorded, under exchanged commands, and from where exchanged joints start.
    """
    exchanged = ordered(p.joint, chosen) - renamed
    return _closer(p, chosen, own, commanded, exchanged) or _clear(p, chosen, own, commanded, exchanged)


def _clear(p: Paired, chosen: Index, own: Array, commanded: Array, exchanged: Array) -> Swap | None:
    """Return the exchange where several joints that it moves do what the scene's do, and did not before."""
    moved = chosen != np.arange(len(chosen))
    left = {"action": p.joint - commanded, "joint_position": exchanged}
    channels = tuple(name for name, off in left.items() if _clearly(off, p.joint - own, moved))
    if not channels:
        return None
    after = min(float(np.median(distances(left[name], moved))) for name in channels)
    return Swap(chosen, channels, (True,) * len(p.joint), (after, float(np.median(distances(p.joint - own, moved)))))


def _closer(p: Paired, chosen: Index, own: Array, commanded: Array, exchanged: Array) -> Swap | None:
    """Return the exchange where all joints that it moves come closer, in all episodes or in those that ask for it.

    Parameters
    ----------
    exchanged : (E, T, S) float64
        Difference of joints exchanged, from where the scene's go then.
    """
    moved = chosen != np.arange(len(chosen))
    given, commands = (distances(p.joint - v, moved) for v in (own, commanded))
    joints = distances(exchanged, moved)
    best = np.minimum(commands, joints)
    away = distances(_from_zero(p.joint - own), moved)
    asked, against = best < CLOSER * away, given < CLOSER * best
    if not (np.median(best) < CLOSER * np.median(away) or asked.sum() >= AT_LEAST):
        return None
    holds = asked if against.any() else np.ones(len(given), bool)
    if holds.sum() < min(AT_LEAST, len(given)):
        return None
    if not any(_each_closer(off, p.joint - own, moved, holds) for off in (p.joint - commanded, exchanged)):
        return None
    as_commands, as_joints = (float(np.median(v[holds])) for v in (commands, joints))
    rivals = [("action", as_joints), ("joint_position", as_commands)]
    told = tuple(name for name, rival in rivals if min(as_commands, as_joints) < CLOSER * rival)
    both = (min(as_commands, as_joints), float(np.median(distances(p.joint - own, moved)[holds])))
    return Swap(chosen, told if len(told) == 1 else ("action", "joint_position"), tuple(holds.tolist()), both)


def swap_findings(p: Paired, recs: Recordings, found: Sequence[Swap]) -> list[RecordingMismatch]:
    """Return the findings that joints follow each other's commands, one for those of the same episodes and channel."""
    groups: dict[tuple[tuple[bool, ...], tuple[str, ...]], list[Swap]] = {}
    for one in found:
        groups.setdefault((one.episodes, one.channels), []).append(one)
    return [_swapped(p, recs, group) for group in groups.values()]


def _swapped(p: Paired, recs: Recordings, group: Sequence[Swap]) -> RecordingMismatch:
    """Return the finding of exchanges that hold in the same episodes."""
    chosen = np.arange(len(p.names))
    for one in group:
        chosen = np.where(one.chosen != np.arange(len(chosen)), one.chosen, chosen)
    moved = np.flatnonzero(chosen != np.arange(len(chosen)))
    channels, episodes = group[0].channels, np.array(group[0].episodes)
    words = {"action": ("commands", "actuators"), "joint_position": ("joint positions", "joints")}
    what, order = zip(*(words[c] for c in channels), strict=True)
    pairs = ", ".join(f"{p.names[i]} follows the command of {p.names[chosen[i]]}" for i in moved)
    after, before = (max(one.errors[k] for one in group) for k in (0, 1))
    pairs += f": as if these columns were exchanged, error {after:.2g} instead of {before:.2g} rad or m"
    columns = " or ".join(f"`{c}` in the order of `{o}`" for c, o in zip(channels, order, strict=True))
    fix = f"put the columns of {columns} in scene.yaml, or name them"
    return RecordingMismatch(
        "swapped_joints" if channels == ("joint_position",) else "swapped_commands",
        True,
        f"{' or '.join(what)} are in another order than the scene's {' or '.join(order)}",
        "each joint follows its own command",
        pairs if episodes.all() else f"{pairs}, {in_episodes(recs, episodes)}",
        fix if episodes.all() else f"{fix}, the same in every episode",
        channels[0],
        tuple(p.names[i] for i in moved),
    )


def distances(off: Array, some: NDArray[np.bool_]) -> Array:
    """Return `(E,)` the RMS difference of some joints in each episode."""
    part = off[..., some]
    seen = np.isfinite(part)
    return np.sqrt((np.where(seen, part, 0.0) ** 2).sum((1, 2)) / np.maximum(seen.sum((1, 2)), 1))


def _each_closer(off: Array, given: Array, some: NDArray[np.bool_], episodes: NDArray[np.bool_]) -> bool:
    """Tell whether each of some joints is off by less than it is as given, in the median of some episodes."""
    alone = [np.arange(off.shape[2]) == j for j in np.flatnonzero(some)]
    each = [(distances(off[episodes], one), distances(_from_zero(given[episodes]), one)) for one in alone]
    return all(bool(np.median(now) < np.median(before)) for now, before in each)


def _clearly(off: Array, given: Array, some: NDArray[np.bool_]) -> bool:
    """Tell whether several joints that an exchange moves then do what the scene's do, and did not before."""
    alone = [np.arange(off.shape[2]) == j for j in np.flatnonzero(some)]
    each = [(np.median(distances(off, one)), np.median(distances(_from_zero(given), one))) for one in alone]
    return sum(bool(now < CLEAR * before) for now, before in each) >= CLEAR_JOINTS


def _from_zero(off: Array) -> Array:
    """Return differences `(E, T, S)` less the constant of each joint and episode, as far as encoders' zeros may be off.

    A servo hides its encoder's offset until the finger touches: joints whose commands lie as near each other as their
    offsets then look exchanged in the episodes with a touch.
    """
    seen = np.isfinite(off)
    constant = np.where(seen, off, 0.0).sum(1, keepdims=True) / np.maximum(seen.sum(1, keepdims=True), 1)
    return off - np.clip(constant, -ZERO_RAD, ZERO_RAD)


def some_of(chosen: Index, cycle: Sequence[int]) -> tuple[int, ...]:
    """Return the exchange of one cycle, the others as they are."""
    return tuple(int(chosen[i]) if i in cycle else i for i in range(len(chosen)))


def cycles(chosen: Index) -> list[list[int]]:
    """Return the cycles of a permutation that are longer than one."""
    left, out = set(range(len(chosen))), []
    while left:
        start = at = left.pop()
        cycle = [start]
        while int(chosen[at]) != start:
            at = int(chosen[at])
            left.discard(at)
            cycle.append(at)
        if len(cycle) > 1:
            out.append(sorted(cycle))
    return out


def in_episodes(recs: Recordings, some: NDArray[np.bool_], most: int = 6) -> str:
    """Return some episodes as text: how many of those looked at, and the names of the first."""
    names = [name for name, s in zip(recs.ids, some, strict=True) if s]
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"in {len(names)} of {len(recs)} episodes looked at: {', '.join(names[:most])}{more}"
