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
from candata.checks._view import EpisodeView, round_evidence

Array = NDArray[np.float64]
#: Fewest episodes of a source that speak for it.
FEWEST = 2
#: Factor between the sources' scales that is looked at, nearness to a unit's, and share of a channel's elements.
FACTOR, UNIT_NEARNESS, ELEMENT_SHARE = 8.0, 0.4, 0.6
#: Cosine of the mean forces of the two sources below which they are opposite; fewest rows in contact of an episode.
OPPOSITE, ROWS = -0.7, 10
#: Share of the simulated range that the recorded one must lie outside of, and the share when its sign is turned.
OUTSIDE_SHARE, INSIDE_SHARE = 0.9, 0.5
#: Names that a line lists.
NAMES_LISTED = 6
REMEDY = "bring both to one convention: units and order in the map, force and action as declared there"


@dataclass(frozen=True)
class _EpisodeConventions:
    """Conventions of an episode, as far as it shows them.

    Attributes
    ----------
    source : str
        sim or real.
    statements : dict of str to str
        What the record says: how forces and actions are timed, names of joints, actuators and fingertips.
    sizes : dict of str to float
        As `scales` gives them.
    force : dict of str to (3,) float64
        Mean direction of each fingertip's force in contact.
    joints : dict of str to (float, float)
        5 and 95 % quantiles of each joint.
    """

    source: str
    statements: dict[str, str]
    sizes: dict[str, float]
    force: dict[str, Array]
    joints: dict[str, tuple[float, float]]


def _gather(view: EpisodeView) -> _EpisodeConventions | None:
    """Return what an episode tells; None where its record cannot be read."""
    if view.meta is None or view.time_s is None:
        return None
    meta = view.meta
    statements = {
        "force": meta.force if "fingertip_force" in view.raw.arrays else "",
        "action": meta.action if "action" in view.raw.arrays else "",
        "joint_names": ", ".join(meta.joint_names),
        "actuator_names": ", ".join(meta.actuator_names),
        "fingertip_names": ", ".join(meta.fingertip_names),
    }
    joints = {}
    joint = view.complete_values("joint_position")
    if joint is not None:
        low, high = np.nanquantile(joint, [0.05, 0.95], axis=0)
        joints = dict(zip(view.elements("joint_position"), zip(low.tolist(), high.tolist(), strict=True), strict=True))
    return _EpisodeConventions(
        meta.source, {k: v for k, v in statements.items() if v}, scales(view), _directions(view), joints
    )


def _directions(view: EpisodeView) -> dict[str, Array]:
    """Return the mean direction of each fingertip's force while it touches."""
    force = forces(view)
    if force is None:
        return {}
    touch = force.touch & force.has_value
    means = {n: force.xyz[touch[:, k], k].mean(axis=0) for k, n in enumerate(force.names) if touch[:, k].sum() > ROWS}
    return {name: mean / max(float(np.linalg.norm(mean)), 1e-12) for name, mean in means.items()}


def _judge(episodes: Sequence[_EpisodeConventions]) -> Iterator[Finding]:
    """Yield in what simulated and recorded episodes differ that is no physics."""
    sides = [[episode for episode in episodes if episode.source == source] for source in ("sim", "real")]
    if min(map(len, sides)) < FEWEST:
        return  # one world only: nothing to compare
    yield from _record_findings(*sides)
    yield from _unit_findings(*sides)
    yield from _force_sign_findings(*sides)
    yield from _joint_sign_findings(*sides)


def _set_finding(level: Level, channel: str, problem: str, detail: str, **evidence: float | str) -> Finding:
    """Return a finding of the whole set."""
    return Finding(
        level,
        "conventions",
        f"{problem}: {detail}",
        channel=channel,
        problem=problem,
        evidence=round_evidence(evidence),
        remedy=REMEDY,
    )


def _record_findings(sim: Sequence[_EpisodeConventions], real: Sequence[_EpisodeConventions]) -> Iterator[Finding]:
    """Yield what the records state differently."""
    channels = {
        "force": "fingertip_force",
        "action": "action",
        "joint_names": "joint_position",
        "actuator_names": "action",
        "fingertip_names": "fingertip_force",
    }
    for key, channel in channels.items():
        sim_counts, real_counts = (
            Counter(entry.statements[key] for entry in side if key in entry.statements) for side in (sim, real)
        )
        if not sim_counts or not real_counts or set(sim_counts) & set(real_counts):
            continue
        a, b = sim_counts.most_common(1)[0][0], real_counts.most_common(1)[0][0]
        sim_names, real_names = a.split(", "), b.split(", ")
        if set(sim_names) == set(real_names):
            places = [pair for pair in zip(sim_names, real_names, strict=False) if pair[0] != pair[1]]
            sim_text, real_text = (_list_names([pair[side] for pair in places]) for side in (0, 1))
            detail = f"simulated {sim_text}; recorded {real_text}"
            yield _set_finding("warning", channel, f"{key} are in another order", detail, simulated=a, recorded=b)
        else:
            sides = {
                "simulated": [n for n in sim_names if n not in real_names],
                "recorded": [n for n in real_names if n not in sim_names],
            }
            detail = "; ".join(f"only {side} {_list_names(names)}" for side, names in sides.items() if names)
            detail = f"simulated {a}; recorded {b}" if len(sim_names) == len(real_names) == 1 else detail
            yield _set_finding("info", channel, f"the sources state another {key}", detail, simulated=a, recorded=b)


def _list_names(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    omission = f" and {len(names) - NAMES_LISTED} more" if len(names) > NAMES_LISTED else ""
    return ", ".join(names[:NAMES_LISTED]) + omission


def _unit_findings(sim: Sequence[_EpisodeConventions], real: Sequence[_EpisodeConventions]) -> Iterator[Finding]:
    """Yield channels whose scales differ by a unit's factor."""
    sizes = [_medians([episode.sizes for episode in side]) for side in (sim, real)]
    ratios: dict[str, list[float]] = defaultdict(list)
    for key in sorted(sizes[0].keys() & sizes[1].keys()):
        ratios[key.split("/")[0]].append(sizes[1][key] / sizes[0][key])
    for channel, channel_ratios in ratios.items():
        ratio = float(np.exp(np.median(np.log(channel_ratios))))
        is_far = np.abs(np.log(channel_ratios)) > np.log(FACTOR)
        unit = unit_of(ratio, UNIT_NEARNESS)
        if is_far.mean() >= ELEMENT_SHARE and unit:
            detail = f"recorded {ratio:.3g} times simulated, as in {unit}"
            yield _set_finding("warning", channel, f"{channel} is in another unit", detail, ratio=ratio)


def _medians(episode_sizes: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the median of each key over the episodes that have it."""
    keys = {key for sizes in episode_sizes for key in sizes}
    return {key: float(np.median([sizes[key] for sizes in episode_sizes if key in sizes])) for key in keys}


def _force_sign_findings(sim: Sequence[_EpisodeConventions], real: Sequence[_EpisodeConventions]) -> Iterator[Finding]:
    """Yield that forces point the other way in one of the sources."""
    cosines = {}
    for name in sorted({n for episode in sim for n in episode.force} & {n for episode in real for n in episode.force}):
        means = [
            np.mean([episode.force[name] for episode in side if name in episode.force], axis=0) for side in (sim, real)
        ]
        size = float(np.linalg.norm(means[0]) * np.linalg.norm(means[1]))
        if size > 0.25:  # directions that agree within each source
            cosines[name] = float(means[0] @ means[1] / size)
    if cosines and np.median(list(cosines.values())) < OPPOSITE:
        text = ", ".join(f"{name} {cosine:.2f}" for name, cosine in cosines.items())
        yield _set_finding(
            "warning",
            "fingertip_force",
            "forces have the other sign",
            f"cosine of the means: {text}",
            cosine=float(np.median(list(cosines.values()))),
        )


def _joint_sign_findings(sim: Sequence[_EpisodeConventions], real: Sequence[_EpisodeConventions]) -> Iterator[Finding]:
    """Yield joints whose recorded range is the simulated one with the other sign."""
    shared_joints = {n for episode in sim for n in episode.joints} & {n for episode in real for n in episode.joints}
    for name in sorted(shared_joints):
        ranges = []
        for side in (sim, real):
            ends = np.array([episode.joints[name] for episode in side if name in episode.joints])
            ranges.append((float(ends[:, 0].min()), float(ends[:, 1].max())))
        (low, high), (a, b) = ranges
        if high - low < 0.1 or b - a < 0.1:
            continue
        if _overlap((a, b), (low, high)) < 1 - OUTSIDE_SHARE and _overlap((-b, -a), (low, high)) > INSIDE_SHARE:
            problem = f"a joint has the other sign: {name}"
            detail = f"simulated {low:.3g} to {high:.3g}, recorded {a:.3g} to {b:.3g}"
            yield _set_finding("warning", "joint_position", problem, detail, joint=name)


def _overlap(interval: tuple[float, float], reference: tuple[float, float]) -> float:
    """Return the share of one range that lies in another."""
    return max(0.0, min(interval[1], reference[1]) - max(interval[0], reference[0])) / max(
        interval[1] - interval[0], 1e-12
    )


RULE = Rule(meaning="simulated and recorded episodes follow one convention", gather=_gather, judge=_judge)
