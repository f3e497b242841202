"""Rule: forces come when fingers are stopped: not late, not early.

Joints fall behind their commands in the moment in which a finger meets an object, and contact flags turn on. Forces are
timed against both: the lag of most agreement with the flags, and that of most correlation between changes of force
and changes of the distance between commands and joints, over all episodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._drive import pairs
from candata.checks._finding import Finding, Rule
from candata.checks._forces import FingertipForces, flags, forces
from candata.checks._signal import correlation, moving_mean
from candata.checks._view import EpisodeView, round_evidence

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
AGREEING_SHARE = 0.7
#: Fewest episodes with contact, and unlike motions among them; averaging of both [s].
FEWEST, MOTIONS, OVER_S = 3, 2, 0.05
REMEDY = "measure the delay of the force stream and move it (map or import with its own clock)"
LAGS_S = np.round(np.arange(-REACH_S, REACH_S + STEP_S / 2, STEP_S), 6)


@dataclass(frozen=True)
class _Timing:
    """Timing of the forces of an episode.

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


def _gather(view: EpisodeView) -> _Timing | None:
    """Return what an episode tells of the timing of its forces; None where there is no contact."""
    force = forces(view)
    if force is None or not (force.touch & force.has_value).any() or len(force.xyz) < 40:
        return None
    task = (view.meta.task if view.meta else None) or ""
    return _Timing(view.id, task, _by_flags(view, force), _by_stops(view, force))


def _by_flags(view: EpisodeView, force: FingertipForces) -> float:
    """Return how much later forces are than the contact flags [s]; NaN where they do not tell, 0 where they agree."""
    flag = flags(view, force.total.shape[1])
    touch = np.where(force.has_value, force.touch, np.nan)
    if flag is None:
        contact = view.values("contact")
        if contact is None:
            return np.nan
        flag, touch = contact[:, None], np.nan_to_num(touch).max(axis=1, keepdims=True)
    if (np.diff(np.nan_to_num(flag), axis=0) != 0).sum() < 2:
        return np.nan
    reach = min(round(REACH_S * view.rate_hz), len(flag) // 3)
    lags = np.arange(-reach, reach + 1)
    agreements = np.array([_agreement(flag, touch, k) for k in range(-reach, reach + 1)])
    agreement_now, best_index = agreements[reach], int(np.argmax(agreements))
    if agreement_now >= AGREES:
        return 0.0
    return (
        float(lags[best_index] / view.rate_hz)
        if agreements[best_index] > AGREES and agreements[best_index] - agreement_now > GAINS
        else np.nan
    )


def _agreement(flag: Array, touch: Array, rows: int) -> float:
    """Return the share of readings in which the flag is that of the force some rows later."""
    total = len(flag)
    a = flag[max(0, -rows) : total - max(0, rows)]
    b = touch[max(0, rows) : total - max(0, -rows)]
    has_both = np.isfinite(a) & np.isfinite(b)
    return float((a == b)[has_both].mean()) if has_both.any() else 0.0


def _by_stops(view: EpisodeView, force: FingertipForces) -> Array | None:
    """Return the correlation between changes of force and of the distance of joints to commands, at `LAGS_S`."""
    column_pairs = pairs(view)
    joint, command = view.values("joint_position"), view.values("action")
    if not column_pairs or joint is None or command is None:
        return None
    width = max(1, round(OVER_S * view.rate_hz))
    distance = moving_mean(command[:, [a for _, a in column_pairs]] - joint[:, [j for j, _ in column_pairs]], width)
    size = moving_mean(np.sqrt((force.xyz**2).sum(axis=2)), width)
    stops = np.nansum(np.abs(np.diff(distance, axis=0)), axis=1)
    presses = np.nansum(np.abs(np.diff(size, axis=0)), axis=1)
    reach = min(round(REACH_S * view.rate_hz), len(stops) // 3)
    lags = np.arange(-reach, reach + 1)
    return np.interp(
        LAGS_S, lags / view.rate_hz, correlation(stops[:, None], presses[:, None], lags)[:, 0], left=0.0, right=0.0
    )


def _judge(timings: Sequence[_Timing]) -> Iterator[Finding]:
    """Yield episodes whose forces are later than their flags, and a set whose forces come after the stops."""
    late_timings = [timing for timing in timings if abs(timing.flags_s) > max(LATE_S / 2, 0)]
    for timing in late_timings:
        problem = f"forces come {'after' if timing.flags_s > 0 else 'before'} their contact flags"
        yield Finding(
            "error",
            "force_delay",
            f"{problem}, by {1e3 * abs(timing.flags_s):.0f} ms",
            episode=timing.id,
            channel="fingertip_force",
            problem=problem,
            evidence=round_evidence({"late_s": timing.flags_s}),
            remedy=REMEDY,
        )
    with_stops = [timing for timing in timings if timing.stops is not None]
    motions = {timing.task for timing in with_stops}
    if len(with_stops) < FEWEST or len(motions) < MOTIONS:
        if not late_timings and not any(np.isfinite(timing.flags_s) for timing in timings):
            reason = "too few contacts with commands of the joints, or flags, beside them"
            reason = (
                reason if len(with_stops) < FEWEST else "one motion alone does not tell a late force from a late touch"
            )
            yield Finding("unknown", "force_delay", reason, problem=reason)
        return
    curves = np.array([timing.stops for timing in with_stops])
    mean = curves.mean(axis=0)
    k = int(np.argmax(mean))
    near_zero = float(mean[np.abs(LAGS_S) <= LATE_S].max())
    is_near_peak, is_near_zero = np.abs(LAGS_S - LAGS_S[k]) <= LATE_S / 2, np.abs(LAGS_S) <= LATE_S
    agree = float((curves[:, is_near_peak].max(axis=1) > curves[:, is_near_zero].max(axis=1)).mean())
    # What one motion does may be its own: between its command and its touch there is the same time every time.
    other_curves = [np.array([timing.stops for timing in with_stops if timing.task != motion]) for motion in motions]
    is_shared = all(abs(LAGS_S[int(np.argmax(curve.mean(axis=0)))] - LAGS_S[k]) <= LATE_S / 2 for curve in other_curves)
    if (
        mean[k] > HIGH
        and abs(LAGS_S[k]) > LATE_S
        and mean[k] > TIMES * near_zero
        and agree >= AGREEING_SHARE
        and is_shared
    ):
        problem = f"forces come {'after' if LAGS_S[k] > 0 else 'before'} the fingers are stopped"
        text = f"{problem}, by {1e3 * abs(LAGS_S[k]):.0f} ms (correlation {mean[k]:.2f}, within {1e3 * LATE_S:.0f} ms "
        evidence = {"late_s": LAGS_S[k], "correlation": mean[k], "near_zero": near_zero, "episodes": len(curves)}
        yield Finding(
            "warning",
            "force_delay",
            f"{text}{near_zero:.2f})",
            channel="fingertip_force",
            problem=problem,
            evidence=round_evidence(evidence),
            remedy=REMEDY,
        )


RULE = Rule(
    meaning="forces come when fingers are stopped",
    gather=_gather,
    judge=_judge,
    needs=("fingertip_force",),
    idle_reason="no fingertip touches anything",
)
