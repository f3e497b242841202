"""Rule: a channel has one scale throughout the set: no episode is a unit's factor away from the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._scales import scales
from candata.checks._signal import UNITS, spread, unit_of
from candata.checks._view import View, rounded

Array = NDArray[np.float64]
#: Fewest episodes that have a scale, and spreads (of the logarithm) by which one is apart from them.
FEWEST, SPREADS = 5, 5.0
#: Smallest factor that is looked at; nearness to a unit's factor, as a difference of logarithms.
FACTOR, NEAR = 20.0, 0.5
#: Share of a channel's elements that must be apart in the same way.
MOST = 0.6
REMEDY = "give the unit of the source in its map, and import these episodes again"


@dataclass(frozen=True)
class _Scales:
    """Sizes of what moves in an episode, by `channel/element`."""

    id: str
    task: str
    sizes: dict[str, float]


def _gather(view: View) -> _Scales | None:
    """Return the sizes of an episode; None where nothing moves."""
    found = scales(view)
    return _Scales(view.id, (view.meta.task if view.meta else None) or "", found) if found else None


def _judge(seen: Sequence[_Scales]) -> Iterator[Finding]:
    """Yield the channels of episodes that are a unit's factor away from the others."""
    apart: dict[tuple[str, str], list[float]] = defaultdict(list)
    counts: dict[tuple[str, str], int] = defaultdict(int)
    for key in sorted({k for one in seen for k in one.sizes}):
        mine = [one for one in seen if key in one.sizes]
        if len(mine) < FEWEST:
            continue
        sizes = np.log([one.sizes[key] for one in mine])
        off = sizes - np.median(sizes)
        # Half the set may be wrong: the spread is that of the half that lies closest together.
        scale = max(_closest_half(sizes), 0.5 * spread(sizes), 0.05)
        for one, ratio in zip(mine, off, strict=True):
            counts[one.id, key.split("/")[0]] += 1
            if abs(ratio) > max(np.log(FACTOR), SPREADS * scale):
                apart[one.id, key.split("/")[0]].append(float(np.exp(ratio)))
    for (name, channel), ratios in apart.items():
        ratio = float(np.exp(np.median(np.log(ratios))))
        unit = unit_of(ratio, NEAR)
        if unit and len(ratios) >= MOST * counts[name, channel] and _possible(channel, unit):
            problem = f"{channel} is on another scale than in the other episodes"
            yield Finding(
                "warning", "scale", f"{problem}: {ratio:.3g} times, as in {unit}", name, channel, None, problem, (),
                rounded({"ratio": ratio, "as": unit, "elements": len(ratios)}), REMEDY,
            )  # fmt: skip


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
