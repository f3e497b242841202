"""Rule: joints move after their commands, by as much in each episode."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._lags import lag
from candata.checks._signal import spread
from candata.checks._view import View, rounded

#: Rows by which joints may seem to lead: half a row is rounding of the lag.
LEADS = -0.5
#: Share of episodes that must lead before the set does.
MOST = 0.7
#: An episode is apart by so many rows, and by so many spreads of the others; fewest others of its kind.
APART, SPREADS, FEWEST = 0.75, 6.0, 5
REMEDY = "check which command a row holds: `action: next` or `previous` in the map; move the commands"


@dataclass(frozen=True)
class _Lag:
    """Rows by which joints come behind their commands in an episode."""

    id: str
    task: str
    rows: float
    rate_hz: float


def _gather(view: View) -> _Lag | None:
    """Return the lag of an episode; None where its joints do not tell."""
    rows = lag(view)
    task = (view.meta.task if view.meta else None) or ""
    return _Lag(view.id, task, rows, view.rate_hz) if np.isfinite(rows) else None


def _judge(seen: Sequence[_Lag]) -> Iterator[Finding]:
    """Yield a set whose joints lead, and episodes whose lag is not that of the others of their kind."""
    rows = np.array([one.rows for one in seen])
    middle = float(np.median(rows))
    if middle < LEADS and (rows < 0).mean() >= MOST:
        problem = "joints move before their commands"
        yield Finding(
            "warning" if middle > -1.5 else "error", "command_lag",
            f"{problem}: by {-middle:.1f} rows ({-1e3 * middle / seen[0].rate_hz:.0f} ms)", None, "action", None,
            problem, (), rounded({"lag_rows": middle, "episodes": len(seen)}), REMEDY,
        )  # fmt: skip
        return
    for task in sorted({one.task for one in seen}):
        yield from _apart([one for one in seen if one.task == task])


def _apart(seen: Sequence[_Lag]) -> Iterator[Finding]:
    """Yield episodes whose lag differs from that of others of one kind, and is shorter."""
    rows = np.array([one.rows for one in seen])
    middle, scale = float(np.median(rows)), spread(rows)
    if len(seen) <= FEWEST:
        return
    apart = np.abs(rows - middle) > max(APART, SPREADS * max(scale, 0.1))
    for k in np.flatnonzero(apart).tolist():
        problem = "commands are shifted against those of the other episodes"
        sure = rows[k] < LEADS
        yield Finding(
            "warning" if sure else "info", "command_lag",
            f"{problem}: joints come {rows[k]:.1f} rows behind, in the others {middle:.1f}", seen[k].id, "action", None,
            problem, (), rounded({"lag_rows": rows[k], "others_rows": middle, "others_spread_rows": scale}), REMEDY,
        )  # fmt: skip


RULE = Rule(
    meaning="joints move after their commands", gather=_gather, judge=_judge, needs=("joint_position", "action"),
    idle="no joint follows a command of its name closely enough to time it",
)  # fmt: skip
