"""Rule: joints follow their commands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._drive import pairs
from candata.checks._finding import Finding, Rule
from candata.checks._signal import noise
from candata.checks._view import View, rounded

#: A command that moves less than this share of its joint's usual way, or less than this [rad or m or 1] asks nothing.
ASKED_SHARE, ASKED = 0.2, 0.02
#: A joint that moves less than this share of what its command does, beyond noise, stands still.
STILL = 0.03
#: Way made of way commanded, over the set, below which a joint falls short, where so much is commanded.
SHORT, FAR = 0.6, 0.1
REMEDY = "check motor and encoder; leave the joint out, or mark its rows invalid"


@dataclass(frozen=True)
class _Ways:
    """How far joints and their commands move in an episode; `quiet` is the joints' noise."""

    id: str
    names: tuple[str, ...]
    joint: np.ndarray
    command: np.ndarray
    quiet: np.ndarray


def _gather(view: View) -> _Ways | None:
    """Return the ways of joints with a command; None where there are none."""
    driven = pairs(view)
    joint, command = view.values("joint_position"), view.values("action")
    if not driven or joint is None or command is None or len(joint) < 10:
        return None
    names = view.elements("joint_position")
    mine, theirs = joint[:, [j for j, _ in driven]], command[:, [a for _, a in driven]]
    return _Ways(view.id, tuple(names[j] for j, _ in driven), _way(mine), _way(theirs), noise(mine))


def _way(values: np.ndarray) -> np.ndarray:
    """Return how far each column moves, without the farthest hundredth of rows on either side."""
    low, high = np.nanquantile(values, [0.01, 0.99], axis=0)
    return np.asarray(np.nan_to_num(high - low))


def _judge(seen: Sequence[_Ways]) -> Iterator[Finding]:
    """Yield joints that stand still while they are commanded, and joints that fall short."""
    for name in dict.fromkeys(n for one in seen for n in one.names):
        mine = [(one, one.names.index(name)) for one in seen if name in one.names]
        joint, command, quiet = (
            np.array([getattr(one, k)[i] for one, i in mine]) for k in ("joint", "command", "quiet")
        )
        asked = command > max(ASKED, ASKED_SHARE * float(command.max()))
        still = asked & (joint < np.maximum(STILL * command, np.minimum(8 * quiet, 0.1 * command)))
        moves = float(np.median(joint[asked] / command[asked])) if asked.any() else 1.0
        for k in np.flatnonzero(still):
            problem = f"a joint does not follow its command: {name}"
            level = "error" if joint[k] == 0 or still.sum() == asked.sum() > 2 else "warning"
            yield Finding(
                "error" if level == "error" else "warning", "dead_joint",
                f"{problem}, it moves {joint[k]:.3g} where {command[k]:.3g} is commanded", mine[k][0].id,
                "joint_position", None, problem, (),
                rounded({"joint": name, "moved": joint[k], "commanded": command[k]}), REMEDY,
            )  # fmt: skip
        if not still.any() and moves < SHORT and (command > FAR).sum() > 2:
            problem = f"a joint falls short of its command: {name}"
            yield Finding(
                "info", "dead_joint", f"{problem}, it makes {moves:.0%} of the way in {asked.sum()} episodes", None,
                "joint_position", None, problem, (), rounded({"joint": name, "share_of_way": moves}),
                "blocked, limited, weak, or commanded in another unit",
            )  # fmt: skip


RULE = Rule(
    meaning="joints follow their commands", gather=_gather, judge=_judge, needs=("joint_position", "action"),
    idle="commands and joints do not go by the same names",
)  # fmt: skip
