"""Rule: simulated and recorded episodes of one set mean the same by the same numbers."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.checks._forces import forces
from candata.checks._scales import scales
from candata.checks._signal import unit_of
from candata.checks._view import View, rounded

Array = NDArray[np.float64]
#: Fewest episodes of a source that speak for it.
FEWEST = 2
#: Factor between the sources' scales that is looked at, nearness to a unit's, and share of a channel's elements.
FACTOR, NEAR, MOST = 8.0, 0.4, 0.6
#: Cosine of the mean forces of the two sources below which they are opposite; fewest rows in contact of an episode.
OPPOSITE, ROWS = -0.7, 10
#: Share of the simulated range that the recorded one must lie outside of, and the share when its sign is turned.
OUTSIDE, INSIDE = 0.9, 0.5
#: Names that a line tells.
NAMED = 6
REMEDY = "bring both to one convention: units and order in the map, force and action as declared there"


@dataclass(frozen=True)
class _Manner:
    """What an episode tells of its conventions.

    Attributes
    ----------
    source : str
        sim or real.
    stated : dict of str to str
        What the record says: how forces and actions are timed, names of joints, actuators and fingertips.
    sizes : dict of str to float
        As `scales` gives them.
    force : dict of str to (3,) float64
        Mean direction of each fingertip's force in contact.
    joints : dict of str to (float, float)
        5 and 95 % quantiles of each joint.
    """

    source: str
    stated: dict[str, str]
    sizes: dict[str, float]
    force: dict[str, Array]
    joints: dict[str, tuple[float, float]]


def _gather(view: View) -> _Manner | None:
    """Return what an episode tells; None where its record cannot be read."""
    if view.meta is None or view.time_s is None:
        return None
    meta = view.meta
    stated = {
        "force": meta.force if "fingertip_force" in view.raw.arrays else "",
        "action": meta.action if "action" in view.raw.arrays else "",
        "joint_names": ", ".join(meta.joint_names),
        "actuator_names": ", ".join(meta.actuator_names),
        "fingertip_names": ", ".join(meta.fingertip_names),
    }
    joints = {}
    joint = view.whole("joint_position")
    if joint is not None:
        low, high = np.nanquantile(joint, [0.05, 0.95], axis=0)
        joints = dict(zip(view.elements("joint_position"), zip(low.tolist(), high.tolist(), strict=True), strict=True))
    return _Manner(meta.source, {k: v for k, v in stated.items() if v}, scales(view), _directions(view), joints)


def _directions(view: View) -> dict[str, Array]:
    """Return the mean direction of each fingertip's force while it touches."""
    force = forces(view)
    if force is None:
        return {}
    touch = force.touch & force.seen
    means = {n: force.xyz[touch[:, k], k].mean(axis=0) for k, n in enumerate(force.names) if touch[:, k].sum() > ROWS}
    return {name: mean / max(float(np.linalg.norm(mean)), 1e-12) for name, mean in means.items()}


def _judge(seen: Sequence[_Manner]) -> Iterator[Finding]:
    """Yield in what simulated and recorded episodes differ that is no physics."""
    sides = [[one for one in seen if one.source == source] for source in ("sim", "real")]
    if min(map(len, sides)) < FEWEST:
        return  # one world only: nothing to compare
    yield from _stated(*sides)
    yield from _scaled(*sides)
    yield from _opposed(*sides)
    yield from _turned(*sides)


def _differ(level: Level, channel: str, problem: str, detail: str, **evidence: float | str) -> Finding:
    """Return a finding of the whole set."""
    return Finding(
        level, "conventions", f"{problem}: {detail}", None, channel, None, problem, (), rounded(evidence), REMEDY
    )


def _stated(sim: Sequence[_Manner], real: Sequence[_Manner]) -> Iterator[Finding]:
    """Yield what the records state differently."""
    channels = {"force": "fingertip_force", "action": "action", "joint_names": "joint_position",
                "actuator_names": "action", "fingertip_names": "fingertip_force"}  # fmt: skip
    for key, channel in channels.items():
        first, second = (Counter(one.stated[key] for one in side if key in one.stated) for side in (sim, real))
        if not first or not second or set(first) & set(second):
            continue
        a, b = first.most_common(1)[0][0], second.most_common(1)[0][0]
        mine, other = a.split(", "), b.split(", ")
        if set(mine) == set(other):
            places = [pair for pair in zip(mine, other, strict=False) if pair[0] != pair[1]]
            detail = f"simulated {_some([one for one, _ in places])}; recorded {_some([one for _, one in places])}"
            yield _differ("warning", channel, f"{key} are in another order", detail, simulated=a, recorded=b)
        else:
            sides = {"simulated": [n for n in mine if n not in other], "recorded": [n for n in other if n not in mine]}
            detail = "; ".join(f"only {side} {_some(names)}" for side, names in sides.items() if names)
            detail = f"simulated {a}; recorded {b}" if len(mine) == len(other) == 1 else detail
            yield _differ("info", channel, f"the sources state another {key}", detail, simulated=a, recorded=b)


def _some(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def _scaled(sim: Sequence[_Manner], real: Sequence[_Manner]) -> Iterator[Finding]:
    """Yield channels whose scales differ by a unit's factor."""
    sizes = [_medians([one.sizes for one in side]) for side in (sim, real)]
    ratios: dict[str, list[float]] = defaultdict(list)
    for key in sorted(sizes[0].keys() & sizes[1].keys()):
        ratios[key.split("/")[0]].append(sizes[1][key] / sizes[0][key])
    for channel, found in ratios.items():
        ratio = float(np.exp(np.median(np.log(found))))
        far = np.abs(np.log(found)) > np.log(FACTOR)
        unit = unit_of(ratio, NEAR)
        if far.mean() >= MOST and unit:
            detail = f"recorded {ratio:.3g} times simulated, as in {unit}"
            yield _differ("warning", channel, f"{channel} is in another unit", detail, ratio=ratio)


def _medians(some: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the median of each key over the episodes that have it."""
    keys = {key for one in some for key in one}
    return {key: float(np.median([one[key] for one in some if key in one])) for key in keys}


def _opposed(sim: Sequence[_Manner], real: Sequence[_Manner]) -> Iterator[Finding]:
    """Yield that forces point the other way in one of the sources."""
    cosines = {}
    for name in sorted({n for one in sim for n in one.force} & {n for one in real for n in one.force}):
        means = [np.mean([one.force[name] for one in side if name in one.force], axis=0) for side in (sim, real)]
        size = float(np.linalg.norm(means[0]) * np.linalg.norm(means[1]))
        if size > 0.25:  # directions that agree within each source
            cosines[name] = float(means[0] @ means[1] / size)
    if cosines and np.median(list(cosines.values())) < OPPOSITE:
        text = ", ".join(f"{name} {cosine:.2f}" for name, cosine in cosines.items())
        yield _differ("warning", "fingertip_force", "forces have the other sign", f"cosine of the means: {text}",
                      cosine=float(np.median(list(cosines.values()))))  # fmt: skip


def _turned(sim: Sequence[_Manner], real: Sequence[_Manner]) -> Iterator[Finding]:
    """Yield joints whose recorded range is the simulated one with the other sign."""
    both = {n for one in sim for n in one.joints} & {n for one in real for n in one.joints}
    for name in sorted(both):
        ranges = []
        for side in (sim, real):
            ends = np.array([one.joints[name] for one in side if name in one.joints])
            ranges.append((float(ends[:, 0].min()), float(ends[:, 1].max())))
        (low, high), (a, b) = ranges
        if high - low < 0.1 or b - a < 0.1:
            continue
        if _overlap((a, b), (low, high)) < 1 - OUTSIDE and _overlap((-b, -a), (low, high)) > INSIDE:
            problem = f"a joint has the other sign: {name}"
            detail = f"simulated {low:.3g} to {high:.3g}, recorded {a:.3g} to {b:.3g}"
            yield _differ("warning", "joint_position", problem, detail, joint=name)


def _overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Return the share of one range that lies in another."""
    return max(0.0, min(one[1], other[1]) - max(one[0], other[0])) / max(one[1] - one[0], 1e-12)


RULE = Rule(meaning="simulated and recorded episodes follow one convention", gather=_gather, judge=_judge)
