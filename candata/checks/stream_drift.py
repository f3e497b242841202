"""Rule: streams keep their distance: the lag between commands and joints does not grow through an episode."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._lags import lag
from candata.checks._signal import spread
from candata.checks._view import View, rounded

#: Growth of the lag over an episode that is worth a look [s], and in rows.
GROWS_S, GROWS_ROWS = 0.04, 1.5
#: By how many spreads of the mean growth, and fewest episodes.
SPREADS, FEWEST = 5.0, 4
#: Drift beyond which a stated alignment is told [ppm]: quartz clocks keep within 100.
TOLD_PPM = 500.0
REMEDY = "measure the clocks of both streams and resample one onto the other's (candata import log does)"


@dataclass(frozen=True)
class _Growth:
    """Lag in the first and the last third of an episode, in seconds."""

    id: str
    first_s: float
    last_s: float
    rate_hz: float


def _episode(view: View) -> Iterator[Finding]:
    """Yield a stated drift that is large."""
    aligned = view.meta.alignment if view.meta else None
    if aligned is not None and abs(aligned.drift_ppm) > TOLD_PPM:
        yield view.finding(
            "info", "stream_drift", "the clocks drifted apart and were brought together",
            f"{aligned.drift_ppm:.0f} ppm ({aligned.method})", "time_ns", drift_ppm=aligned.drift_ppm,
        )  # fmt: skip


def _gather(view: View) -> _Growth | None:
    """Return the lags at both ends of an episode; None where one is not told."""
    total = len(view.raw.arrays["time_ns"])
    first, last = (lag(view, rows) for rows in (slice(0, total * 2 // 5), slice(total * 3 // 5, total)))
    if not (np.isfinite(first) and np.isfinite(last)):
        return None
    return _Growth(view.id, first / view.rate_hz, last / view.rate_hz, view.rate_hz)


def _judge(seen: Sequence[_Growth]) -> Iterator[Finding]:
    """Yield that the lag grows in the same way in nearly all episodes."""
    growth = np.array([one.last_s - one.first_s for one in seen]) / 0.6  # ends are 0.6 of an episode apart
    middle, scale = float(np.median(growth)), spread(growth)
    if len(seen) < FEWEST:
        reason = "too few episodes in which the lag can be read at both ends"
        yield Finding("unknown", "stream_drift", reason, problem=reason)
        return
    if abs(middle) > max(GROWS_S, GROWS_ROWS / seen[0].rate_hz, SPREADS * scale / np.sqrt(len(seen))):
        problem = "streams drift apart"
        yield Finding(
            "warning", "stream_drift", f"{problem}: joints fall behind their commands by {1e3 * middle:.0f} ms from "
            f"the first row to the last (median of {len(seen)} episodes)", None, "joint_position", None, problem, (),
            rounded({"growth_s": middle, "spread_s": scale, "episodes": len(seen)}), REMEDY,
        )  # fmt: skip


RULE = Rule(
    meaning="streams do not drift apart", episode=_episode, gather=_gather, judge=_judge,
    needs=("joint_position", "action"), idle="no joint follows its command closely enough to time it",
)  # fmt: skip
