"""Rule: forces come when fingers are stopped: not late, not early.

Where a finger meets an object its joints fall behind their commands in that moment, and contact flags turn on. Forces
are timed against both: the lag of most agreement with the flags, and that of most correlation between changes of force
and changes of the distance between commands and joints, over all episodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._drive import pairs
from candata.checks._finding import Finding, Rule
from candata.checks._forces import Forces, flags, forces
from candata.checks._signal import correlation, smooth
from candata.checks._view import View, rounded

Array = NDArray[np.float64]
#: Lags that are tried, both ways [s], and the step between them where episodes are compared [s].
REACH_S, STEP_S = 0.5, 0.01
#: Lag beyond which forces are late [s]: above tactile filters and delays of 30 ms.
LATE_S = 0.05
#: Agreement with the flags at the best lag, and what it must gain on no lag.
AGREES, GAINS = 0.97, 0.02
#: Correlation over all episodes at the best lag, and how many times that near zero it must be.
HIGH, TIMES = 0.25, 1.8
#: Share of the episodes that must correlate better there than near zero.
MOST = 0.7
#: Fewest episodes with contact, and unlike motions among them; averaging of both [s].
FEWEST, MOTIONS, OVER_S = 3, 2, 0.05
REMEDY = "measure the delay of the force stream and move it (map or import with its own clock)"
LAGS_S = np.round(np.arange(-REACH_S, REACH_S + STEP_S / 2, STEP_S), 6)


@dataclass(frozen=True)
class _Timing:
    """What an episode tells of its forces.

    Attributes
    ----------
    id, task : str
    flags_s : float
        How much later they are than flags [s]; NaN unless sure.
    stops : (L,) float64, optional
        Their correlation with stops at `LAGS_S`.
    """

    id: str
    task: str
    flags_s: float
    stops: Array | None


def _gather(view: View) -> _Timing | None:
    """Return what an episode tells of the timing of its forces; None where there is no contact."""
    force = forces(view)
    if force is None or not (force.touch & force.seen).any() or len(force.xyz) < 40:
        return None
    task = (view.meta.task if view.meta else None) or ""
    return _Timing(view.id, task, _by_flags(view, force), _by_stops(view, force))


def _by_flags(view: View, force: Forces) -> float:
    """Return how much later forces are than the contact flags [s]; NaN where they do not tell, 0 where they agree."""
    flag = flags(view, force.total.shape[1])
    touch = np.where(force.seen, force.touch, np.nan)
    if flag is None:
        whole = view.values("contact")
        if whole is None:
            return np.nan
        flag, touch = whole[:, None], np.nan_to_num(touch).max(axis=1, keepdims=True)
    if (np.diff(np.nan_to_num(flag), axis=0) != 0).sum() < 2:
        return np.nan
    reach = min(round(REACH_S * view.rate_hz), len(flag) // 3)
    lags = np.arange(-reach, reach + 1)
    same = np.array([_agreement(flag, touch, k) for k in range(-reach, reach + 1)])
    now, best = same[reach], int(np.argmax(same))
    if now >= AGREES:
        return 0.0
    return float(lags[best] / view.rate_hz) if same[best] > AGREES and same[best] - now > GAINS else np.nan


def _agreement(flag: Array, touch: Array, rows: int) -> float:
    """Return the share of readings in which the flag is that of the force some rows later."""
    total = len(flag)
    a = flag[max(0, -rows) : total - max(0, rows)]
    b = touch[max(0, rows) : total - max(0, -rows)]
    seen = np.isfinite(a) & np.isfinite(b)
    return float((a == b)[seen].mean()) if seen.any() else 0.0


def _by_stops(view: View, force: Forces) -> Array | None:
    """Return the correlation between changes of force and of the distance of joints to commands, at `LAGS_S`."""
    driven = pairs(view)
    joint, command = view.values("joint_position"), view.values("action")
    if not driven or joint is None or command is None:
        return None
    width = max(1, round(OVER_S * view.rate_hz))
    distance = smooth(command[:, [a for _, a in driven]] - joint[:, [j for j, _ in driven]], width)
    size = smooth(np.sqrt((force.xyz**2).sum(axis=2)), width)
    stops = np.nansum(np.abs(np.diff(distance, axis=0)), axis=1)
    presses = np.nansum(np.abs(np.diff(size, axis=0)), axis=1)
    reach = min(round(REACH_S * view.rate_hz), len(stops) // 3)
    lags = np.arange(-reach, reach + 1)
    return np.interp(
        LAGS_S, lags / view.rate_hz, correlation(stops[:, None], presses[:, None], lags)[:, 0], left=0.0, right=0.0
    )


def _judge(seen: Sequence[_Timing]) -> Iterator[Finding]:
    """Yield episodes whose forces are later than their flags, and a set whose forces come after the stops."""
    late = [one for one in seen if abs(one.flags_s) > max(LATE_S / 2, 0)]
    for one in late:
        problem = f"forces come {'after' if one.flags_s > 0 else 'before'} their contact flags"
        yield Finding(
            "error", "force_delay", f"{problem}, by {1e3 * abs(one.flags_s):.0f} ms", one.id, "fingertip_force", None,
            problem, (), rounded({"late_s": one.flags_s}), REMEDY,
        )  # fmt: skip
    timed = [one for one in seen if one.stops is not None]
    motions = {one.task for one in timed}
    if len(timed) < FEWEST or len(motions) < MOTIONS:
        if not late and not any(np.isfinite(one.flags_s) for one in seen):
            reason = "too few contacts with commands of the joints, or flags, beside them"
            reason = reason if len(timed) < FEWEST else "one motion alone does not tell a late force from a late touch"
            yield Finding("unknown", "force_delay", reason, problem=reason)
        return
    curves = np.array([one.stops for one in timed])
    mean = curves.mean(axis=0)
    k = int(np.argmax(mean))
    near = float(mean[np.abs(LAGS_S) <= LATE_S].max())
    about, zero = np.abs(LAGS_S - LAGS_S[k]) <= LATE_S / 2, np.abs(LAGS_S) <= LATE_S
    agree = float((curves[:, about].max(axis=1) > curves[:, zero].max(axis=1)).mean())
    # What one motion does may be its own: between its command and its touch there is the same time every time.
    without = [np.array([one.stops for one in timed if one.task != motion]) for motion in motions]
    alike = all(abs(LAGS_S[int(np.argmax(curve.mean(axis=0)))] - LAGS_S[k]) <= LATE_S / 2 for curve in without)
    if mean[k] > HIGH and abs(LAGS_S[k]) > LATE_S and mean[k] > TIMES * near and agree >= MOST and alike:
        problem = f"forces come {'after' if LAGS_S[k] > 0 else 'before'} the fingers are stopped"
        text = f"{problem}, by {1e3 * abs(LAGS_S[k]):.0f} ms (correlation {mean[k]:.2f}, within {1e3 * LATE_S:.0f} ms "
        evidence = {"late_s": LAGS_S[k], "correlation": mean[k], "near_zero": near, "episodes": len(curves)}
        yield Finding(
            "warning",
            "force_delay",
            f"{text}{near:.2f})",
            None,
            "fingertip_force",
            None,
            problem,
            (),
            rounded(evidence),
            REMEDY,
        )


RULE = Rule(
    meaning="forces come when fingers are stopped", gather=_gather, judge=_judge, needs=("fingertip_force",),
    idle="no fingertip touches anything",
)  # fmt: skip
