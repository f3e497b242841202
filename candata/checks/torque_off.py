"""Rule: servos drive their joints throughout."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView

REMEDY = "a diagnosis compares the rows before: after them a replay follows the commands, the servo does not"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield actuators that do not drive in some rows."""
    torque_on = view.values("torque_on")
    if torque_on is None:
        return
    for column, name in enumerate(view.elements("torque_on")):
        rows = torque_on[:, column] == 0
        if rows.any():
            yield view.finding(
                "warning",
                "torque_off",
                "a servo's torque is off: it does not hold its joint",
                f"{name} in {rows.sum()} of {np.isfinite(torque_on[:, column]).sum()} rows",
                "torque_on",
                rows,
                REMEDY,
                actuator=name,
                rows=int(rows.sum()),
            )


RULE = Rule(meaning="servos drive their joints throughout", episode=_episode)
