"""Rule: the drives' supply does not sag."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView

#: Share of the usual voltage by which it must fall. Stall torque and no-load speed of a DC motor are proportional to
#: the voltage. Chosen: a tenth of a drive's strength is what a diagnosis would name.
SAG_SHARE = 0.1
#: Fewest rows: a single reading may be wrong.
FEWEST = 3
REMEDY = "use a stiffer supply or shorter wires; torque and speed of these servos fall with the voltage"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield actuators whose supply falls below its usual voltage."""
    voltage = view.values("supply_voltage")
    if voltage is None:
        return
    for column, name in enumerate(view.elements("supply_voltage")):
        reading = voltage[:, column]
        if not np.isfinite(reading).any():
            continue
        usual = float(np.nanmedian(reading))
        rows = reading < (1 - SAG_SHARE) * usual
        if rows.sum() >= FEWEST:
            lowest = float(np.nanmin(reading))
            yield view.finding(
                "warning",
                "supply_sag",
                "the supply sags",
                f"at {name} from {usual:.3g} to {lowest:.3g} V, below {100 * (1 - SAG_SHARE):g} % in {rows.sum()} rows",
                "supply_voltage",
                rows,
                REMEDY,
                actuator=name,
                usual_V=usual,
                lowest_V=lowest,
                rows=int(rows.sum()),
            )


RULE = Rule(meaning="the supply does not sag", episode=_episode)
