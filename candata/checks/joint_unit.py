"""Rule: joints are radians or metres, and commands are of the joints' unit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._drive import pairs
from candata.checks._finding import Finding, Rule
from candata.checks._signal import UNITS, unit_of
from candata.checks._view import View, rounded

#: A joint that turns farther than this is in degrees, or turns freely: four turns [rad].
TURNS_RAD = 8 * np.pi
#: Correlation of a joint with its command from which their ratio counts, and the ratios that are no unit's.
FOLLOWS, PLAIN = 0.9, 5.0
REMEDY = "give the unit in the map (`units: {joint_position: deg}`)"


@dataclass(frozen=True)
class _Size:
    """Of each joint: the farthest value, and command over joint where it follows (else NaN)."""

    id: str
    names: tuple[str, ...]
    largest: np.ndarray
    ratio: np.ndarray


def _gather(view: View) -> _Size | None:
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
    seen = np.isfinite(joint) & np.isfinite(command)
    if seen.sum() < 10 or joint[seen].std() == 0 or command[seen].std() == 0:
        return np.nan
    correlation = float(np.corrcoef(joint[seen], command[seen])[0, 1])
    return float(command[seen].std() / joint[seen].std()) if correlation > FOLLOWS else np.nan


def _judge(seen: Sequence[_Size]) -> Iterator[Finding]:
    """Yield joints that are far beyond a turn, and joints whose commands are in another unit."""
    for name in dict.fromkeys(n for one in seen for n in one.names):
        mine = [one for one in seen if name in one.names]
        largest = float(np.nanmax([one.largest[one.names.index(name)] for one in mine]))
        ratios = np.array([one.ratio[one.names.index(name)] for one in mine])
        ratio = float(np.median(ratios[np.isfinite(ratios)])) if np.isfinite(ratios).any() else 1.0
        unit = unit_of(ratio, 0.25) if max(ratio, 1 / ratio) > PLAIN else ""
        if unit and unit in list(UNITS)[:2] + list(UNITS)[-1:]:
            problem = f"a joint and its command are in different units: {name}"
            yield Finding(
                "warning", "joint_unit", f"{problem}, command {ratio:.4g} times the joint, as in {unit}", None,
                "action", None, problem, (), rounded({"ratio": ratio, "joint": name}), REMEDY,
            )  # fmt: skip
        elif largest > TURNS_RAD:
            problem = "joints move by more than four turns"
            yield Finding(
                "info", "joint_unit", f"{problem}: {name} reaches {largest:.4g}: in degrees, or it turns freely", None,
                "joint_position", None, problem, (), rounded({"largest": largest, "joint": name}), REMEDY,
            )  # fmt: skip


RULE = Rule(meaning="joints are radians or metres", gather=_gather, judge=_judge, needs=("joint_position",))
