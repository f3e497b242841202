"""Rule: streams keep their distance: the lag between commands and joints does not grow through an episode."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._lags import CLOSELY, FREELY, JointLags, joint_lags
from candata.checks._signal import spread
from candata.checks._view import EpisodeView, round_evidence

#: Growth of the lag over an episode that is worth a look [s], and in rows.
GROWS_S, GROWS_ROWS = 0.04, 1.5
#: By how many spreads of the mean growth; fewest episodes and joints that tell it; the least share of it in each joint.
SPREADS, FEWEST, JOINTS, LEAST_SHARE = 5.0, 4, 2, 0.5
#: Drift beyond which a stated alignment is reported [ppm]: quartz clocks keep within 100.
TOLD_PPM = 500.0
REMEDY = "measure the clocks of both streams and resample one onto the other's (candata import log does)"


@dataclass(frozen=True)
class _Growth:
    """By how much each joint that follows freely falls behind its command through an episode, by name [s]."""

    id: str
    by_joint_s: dict[str, float]
    rate_hz: float


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield a stated drift that is large."""
    alignment = view.meta.alignment if view.meta else None
    if alignment is not None and abs(alignment.drift_ppm) > TOLD_PPM:
        yield view.finding(
            "info",
            "stream_drift",
            "the clocks drifted apart and were brought together",
            f"{alignment.drift_ppm:.0f} ppm ({alignment.method})",
            "time_ns",
            drift_ppm=alignment.drift_ppm,
        )


def _gather(view: EpisodeView) -> _Growth | None:
    """Return the growth of the lags between both ends of an episode; None where none is told."""
    total = len(view.raw.arrays["time_ns"])
    ends = [_free(joint_lags(view, rows)) for rows in (slice(0, total * 2 // 5), slice(total * 3 // 5, total))]
    # The ends are 0.6 of an episode apart.
    shared_joints = ends[0].keys() & ends[1].keys()
    growth_s = {name: (ends[1][name] - ends[0][name]) / 0.6 / view.rate_hz for name in shared_joints}
    return _Growth(view.id, growth_s, view.rate_hz) if growth_s else None


def _free(lags: JointLags | None) -> dict[str, float]:
    """Return the lags of the joints that follow their commands freely, by name [rows]."""
    if lags is None:
        return {}
    free = np.isfinite(lags.by_joint) & (lags.correlations > CLOSELY) & (lags.share > FREELY)
    return {name: float(rows) for name, rows, f in zip(lags.names, lags.by_joint, free, strict=True) if f}


def _judge(lag_growths: Sequence[_Growth]) -> Iterator[Finding]:
    """Yield that the lag grows alike in all joints and nearly all episodes: a clock is one for all of them."""
    names = {name for episode in lag_growths for name in episode.by_joint_s}
    by_joint = [[episode.by_joint_s[n] for episode in lag_growths if n in episode.by_joint_s] for n in names]
    growth = np.array([np.median(growths) for growths in by_joint if len(growths) >= FEWEST])
    if len(growth) < JOINTS:
        reason = "too few joints follow their commands freely at both ends of the episodes"
        yield Finding("unknown", "stream_drift", reason, problem=reason)
        return
    episodes = np.array([np.median(list(episode.by_joint_s.values())) for episode in lag_growths])
    median_s, scale = float(np.median(episodes)), spread(episodes)
    least_s = max(GROWS_S, GROWS_ROWS / lag_growths[0].rate_hz, SPREADS * scale / np.sqrt(len(lag_growths)))
    if abs(median_s) > least_s and (growth * np.sign(median_s) > LEAST_SHARE * abs(median_s)).all():
        problem = "streams drift apart"
        text = (
            f"{problem}: joints fall behind their commands by {1e3 * median_s:.0f} ms from the first row to the last "
        )
        text += f"(median of {len(lag_growths)} episodes, {len(growth)} joints alike)"
        evidence = round_evidence(
            {"growth_s": median_s, "spread_s": scale, "episodes": len(lag_growths), "joints": len(growth)}
        )
        yield Finding(
            "warning",
            "stream_drift",
            text,
            channel="joint_position",
            problem=problem,
            evidence=evidence,
            remedy=REMEDY,
        )


RULE = Rule(
    meaning="streams do not drift apart",
    episode=_episode,
    gather=_gather,
    judge=_judge,
    needs=("joint_position", "action"),
    idle_reason="no joint follows its command closely enough to time it",
)
