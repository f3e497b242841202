"""Rule: a channel has one scale throughout the set: no episode is a unit's factor away from the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._scales import reaches, scales
from candata.checks._signal import UNITS, spread, unit_of
from candata.checks._view import View, rounded

Array = NDArray[np.float64]
#: An episode's id and a channel of it.
_Key = tuple[str, str]
#: Fewest episodes that have a scale, and spreads (of the logarithm) by which one is apart from them.
FEWEST, SPREADS = 5, 5.0
#: Smallest factor that is looked at; nearness to a unit's factor, as a difference of logarithms.
FACTOR, NEAR = 20.0, 0.5
#: Share of a channel's elements that must be apart in the same way.
MOST = 0.6
#: Nearness of the noise's factor to a unit's, as a difference of logarithms: a factor of three.
NOISE = 1.1
REMEDY = "give the unit of the source in its map, and import these episodes again"


@dataclass(frozen=True)
class _Scales:
    """Sizes of what moves in an episode, how far its values reach, and their noise, by `channel/element`."""

    id: str
    sizes: dict[str, float]
    reach: dict[str, float]
    quiet: dict[str, float]


def _gather(view: View) -> _Scales | None:
    """Return the sizes of an episode; None where nothing moves."""
    found = scales(view)
    return _Scales(view.id, found, *reaches(view)) if found else None


def _judge(seen: Sequence[_Scales]) -> Iterator[Finding]:
    """Yield the channels of episodes that are a unit's factor away from the others.

    Commands as far away as the positions of their joints ask for less motion, no more: they are in another unit only
    where those positions are found to be.
    """
    sizes, apart = _compare(seen)
    found = {key: unit for key in sizes if (unit := _unit(sizes[key], apart[key], key[1]))}
    judged = {key: (ratio, unit) for key, (ratio, unit) in found.items() if _scaled(seen, key, apart[key], ratio)}
    for name, channel in sizes:
        if channel == "action" and (name, channel) in judged and (name, "joint_position") not in judged:
            moved = sizes.get((name, "joint_position"), {})
            alike = {k for k in apart[name, channel] if abs(sizes[name, channel][k] - moved.get(k, np.inf)) < NEAR}
            if not _unit(sizes[name, channel], apart[name, channel] - alike, channel):
                del judged[name, channel]
    for (name, channel), (ratio, of) in judged.items():
        problem = f"{channel} is on another scale than in the other episodes"
        yield Finding(
            "warning", "scale", f"{problem}: {ratio:.3g} times, as in {of}", name, channel, None, problem, (),
            rounded({"ratio": ratio, "as": of, "elements": len(apart[name, channel])}), REMEDY,
        )  # fmt: skip


def _compare(seen: Sequence[_Scales]) -> tuple[dict[_Key, dict[str, float]], dict[_Key, set[str]]]:
    """Return logarithms of the elements' sizes over those of most episodes, and the elements that are apart."""
    sizes: dict[_Key, dict[str, float]] = defaultdict(dict)
    apart: dict[_Key, set[str]] = defaultdict(set)
    for key in sorted({k for one in seen for k in one.sizes}):
        mine = [one for one in seen if key in one.sizes]
        if len(mine) < FEWEST:
            continue
        channel, _, element = key.partition("/")
        logs = np.log([one.sizes[key] for one in mine])
        off = logs - np.median(logs)
        # Half the set may be wrong: the spread is that of the half that lies closest together.
        scale = max(_closest_half(logs), 0.5 * spread(logs), 0.05)
        for one, ratio in zip(mine, off, strict=True):
            sizes[one.id, channel][element] = float(ratio)
            if abs(ratio) > max(np.log(FACTOR), SPREADS * scale):
                apart[one.id, channel].add(element)
    return sizes, apart


def _scaled(seen: Sequence[_Scales], key: _Key, apart: set[str], ratio: float) -> bool:
    """Tell whether an episode's values are scaled by a ratio, not only moved by it: noise tells, else their reach."""
    name, channel = key
    (episode,) = [scales for scales in seen if scales.id == name]
    keys = {f"{channel}/{element}" for element in apart if element != "distance"}
    for quantity, within in (("quiet", NOISE), ("reach", NEAR)):
        sizes, others = getattr(episode, quantity), [getattr(scales, quantity) for scales in seen]
        usual = {k: np.median([values[k] for values in others if k in values]) for k in keys & sizes.keys()}
        if 2 * len(usual) > len(keys):
            return bool(abs(np.median([np.log(sizes[k] / usual[k]) for k in usual]) - np.log(ratio)) < within)
    return not keys


def _unit(sizes: dict[str, float], apart: set[str], channel: str) -> tuple[float, str] | None:
    """Return the ratio of the elements apart and its unit; None where they are too few, or the ratio is of none."""
    if not apart or len(apart) < MOST * len(sizes):
        return None
    ratio = float(np.exp(np.median([sizes[k] for k in apart])))
    unit = unit_of(ratio, NEAR)
    return (ratio, unit) if unit and _possible(channel, unit) else None


def _closest_half(values: Array) -> float:
    """Return a standard deviation by the shortest interval that holds half the values (Rousseeuw 1984)."""
    ordered = np.sort(values)
    half = len(ordered) // 2 + 1
    return float((ordered[half - 1 :] - ordered[: len(ordered) - half + 1]).min() / 1.349)


def _possible(channel: str, unit: str) -> bool:
    """Tell whether a channel may be in a unit: forces in no degrees, places in no gram-force."""
    names = list(UNITS)
    wrong = {"fingertip_force": names[-1:], "object_pose": names[2:], "hand_pose": names[2:]}
    return unit not in wrong.get(channel, names[2:4])


RULE = Rule(meaning="a channel has one scale throughout the set", gather=_gather, judge=_judge, idle="nothing moves")
