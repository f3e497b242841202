"""Rule: joints follow their commands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._drive import pairs
from candata.checks._finding import Finding, Rule
from candata.checks._forces import forces, touched
from candata.checks._signal import noise
from candata.checks._view import View, rounded

#: A command that moves less than this share of its joint's usual way, or less than this [rad or m or 1] asks nothing.
ASKED_SHARE, ASKED = 0.2, 0.02
#: A joint that moves less than this share of what its command does, beyond noise, stands still.
STILL = 0.03
#: Distance to a held command, as a share of its way, from which a joint stops short, where so much is commanded.
SHORT, FAR = 0.25, 0.1
#: Time for which a command must be held, within this share of its way [s].
HELD_S, HELD = 0.4, 0.02
#: Share of an episode's rows with a touch from which something is held. Chosen.
HELD_SHARE = 0.5
REMEDY = "check motor and encoder; leave the joint out, or mark its rows invalid"


@dataclass(frozen=True)
class _Ways:
    """How far joints and commands move in an episode, the joints' noise, and how far from held commands they stop.

    `held` tells whether something is touched most of the time: what fingers hold may stop them.
    """

    id: str
    names: tuple[str, ...]
    joint: np.ndarray
    command: np.ndarray
    quiet: np.ndarray
    short: np.ndarray
    held: bool


def _gather(view: View) -> _Ways | None:
    """Return the ways of joints with a command; None where there are none."""
    driven = pairs(view)
    joint, command = view.values("joint_position"), view.values("action")
    if not driven or joint is None or command is None or len(joint) < 10:
        return None
    names = view.elements("joint_position")
    mine, theirs = joint[:, [j for j, _ in driven]], command[:, [a for _, a in driven]]
    short = _short(mine, theirs, round(HELD_S * view.rate_hz))
    return _Ways(view.id, tuple(names[j] for j, _ in driven), _way(mine), _way(theirs), noise(mine), short, _held(view))


def _held(view: View) -> bool:
    """Tell whether something is touched most of the time, by force where it is known, else by flag."""
    force = forces(view)
    touch = touched(view) if force is None else force.touch.any(axis=1)
    return touch is not None and bool(np.nanmean(touch) > HELD_SHARE)


def _way(values: np.ndarray) -> np.ndarray:
    """Return how far each column moves, without the farthest hundredth of rows on either side."""
    low, high = np.nanquantile(values, [0.01, 0.99], axis=0)
    return np.asarray(np.nan_to_num(high - low))


def _short(joint: np.ndarray, command: np.ndarray, rows: int) -> np.ndarray:
    """Return the distance of joints to commands held for so many rows, its 0.9 quantile; NaN where none was held."""
    if not 2 <= rows < len(command):
        return np.full(joint.shape[1], np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(command, rows, axis=0)
    held = windows.max(axis=-1) - windows.min(axis=-1) < HELD * _way(command)
    apart = np.where(held, np.abs(command - joint)[rows - 1 :], np.nan)
    return np.asarray(np.nanquantile(apart, 0.9, axis=0))


def _judge(seen: Sequence[_Ways]) -> Iterator[Finding]:
    """Yield joints that stand still while they are commanded, and those that stop short of their commands."""
    short: dict[str, float] = {}
    for name in dict.fromkeys(n for one in seen for n in one.names):
        mine = [(one, one.names.index(name)) for one in seen if name in one.names]
        ways = np.array([(one.joint[i], one.command[i], one.quiet[i], one.short[i]) for one, i in mine]).T
        joint, command, quiet, left = ways
        asked = command > max(ASKED, ASKED_SHARE * float(command.max()))
        still = asked & (joint < np.maximum(STILL * command, np.minimum(8 * quiet, 0.1 * command)))
        for k in np.flatnonzero(still):
            problem = f"a joint does not follow its command: {name}"
            sure = joint[k] == 0 or (still.sum() == asked.sum() > 2 and not all(one.held for one, _ in mine))
            yield Finding(
                "error" if sure else "warning", "dead_joint",
                f"{problem}, it moves {joint[k]:.3g} where {command[k]:.3g} is commanded", mine[k][0].id,
                "joint_position", None, problem, (),
                rounded({"joint": name, "moved": joint[k], "commanded": command[k]}), REMEDY,
            )  # fmt: skip
        far = np.isfinite(left) & (command > FAR)
        if not still.any() and far.sum() > 2 and np.median(left[far] / command[far]) > SHORT:
            short[name] = float(np.median(left[far] / command[far]))
    if short:
        problem = "joints stop short of commands that are held"
        text = ", ".join(f"{name} by {share:.0%} of the way" for name, share in short.items())
        yield Finding(
            "info", "dead_joint", f"{problem}: {text}", None, "joint_position", None, problem, (), rounded(short),
            "blocked by what they hold or by a limit, weak, or commanded in another unit",
        )  # fmt: skip


RULE = Rule(
    meaning="joints follow their commands", gather=_gather, judge=_judge, needs=("joint_position", "action"),
    idle="commands and joints do not go by the same names",
)  # fmt: skip
