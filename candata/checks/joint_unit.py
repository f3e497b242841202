"""Rule: joints are radians or metres, and commands are of the joints' unit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._drive import pairs
from candata.checks._finding import Finding, Rule
from candata.checks._signal import UNITS, unit_of
from candata.checks._view import EpisodeView, round_evidence

#: A joint that turns farther than this is in degrees, or turns freely: four turns [rad].
TURNS_RAD = 8 * np.pi
#: Correlation of a joint with its command from which their ratio counts, and the ratios that are no unit's.
FOLLOWS, LARGEST_PLAIN_RATIO = 0.9, 5.0
REMEDY = "give the unit in the map (`units: {joint_position: deg}`)"


@dataclass(frozen=True)
class _Size:
    """Sizes of the joints of an episode: the farthest value, and command over joint where it follows (else NaN)."""

    id: str
    names: tuple[str, ...]
    largest_value: np.ndarray
    ratio: np.ndarray


def _gather(view: EpisodeView) -> _Size | None:
    """Return sizes and ratios of the joints; None where there are none."""
    joint = view.values("joint_position")
    if joint is None:
        return None
    ratio = np.full(joint.shape[1], np.nan)
    for j, a in pairs(view):
        command = view.values("action")
        if command is not None:
            ratio[j] = _ratio(joint[:, j], command[:, a])
    return _Size(view.id, view.elements("joint_position"), np.nanmax(np.abs(joint), axis=0), ratio)


def _ratio(joint: np.ndarray, command: np.ndarray) -> float:
    """Return how many times the joint's motion its command is; NaN where it does not follow."""
    has_both = np.isfinite(joint) & np.isfinite(command)
    if has_both.sum() < 10 or joint[has_both].std() == 0 or command[has_both].std() == 0:
        return np.nan
    correlation = float(np.corrcoef(joint[has_both], command[has_both])[0, 1])
    return float(command[has_both].std() / joint[has_both].std()) if correlation > FOLLOWS else np.nan


def _judge(episodes: Sequence[_Size]) -> Iterator[Finding]:
    """Yield joints that are far beyond a turn, and joints whose commands are in another unit."""
    for name in dict.fromkeys(n for episode in episodes for n in episode.names):
        members = [episode for episode in episodes if name in episode.names]
        largest_value = float(np.nanmax([episode.largest_value[episode.names.index(name)] for episode in members]))
        ratios = np.array([episode.ratio[episode.names.index(name)] for episode in members])
        ratio = float(np.median(ratios[np.isfinite(ratios)])) if np.isfinite(ratios).any() else 1.0
        unit = unit_of(ratio, 0.25) if max(ratio, 1 / ratio) > LARGEST_PLAIN_RATIO else ""
        if unit and unit in list(UNITS)[:2] + list(UNITS)[-1:]:
            problem = f"a joint and its command are in different units: {name}"
            yield Finding(
                "warning",
                "joint_unit",
                f"{problem}, command {ratio:.4g} times the joint, as in {unit}",
                channel="action",
                problem=problem,
                evidence=round_evidence({"ratio": ratio, "joint": name}),
                remedy=REMEDY,
            )
        elif largest_value > TURNS_RAD:
            problem = "joints move by more than four turns"
            yield Finding(
                "info",
                "joint_unit",
                f"{problem}: {name} reaches {largest_value:.4g}: in degrees, or it turns freely",
                channel="joint_position",
                problem=problem,
                evidence=round_evidence({"largest": largest_value, "joint": name}),
                remedy=REMEDY,
            )


RULE = Rule(meaning="joints are radians or metres", gather=_gather, judge=_judge, needs=("joint_position",))
