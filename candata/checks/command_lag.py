"""Rule: joints move after their commands: by as much in each episode, and as the scene's do."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._lags import joint_lags, lag
from candata.checks._signal import spread
from candata.checks._view import EpisodeView, round_evidence

#: Rows by which joints may seem to lead: half a row is rounding of the lag.
LEADS = -0.5
#: Share of episodes that must lead before the set does.
LEADING_SHARE = 0.7
#: An episode is apart from others of its kind by so many rows and so many spreads; fewest of a kind, and of the set.
APART_ROWS, SPREADS, KIND, FEWEST = 0.75, 8.0, 3, 6
#: Correlation of its speed with its command's from which a joint has a say, and fewest joints that must say the same.
#: Measured on a hand: free sweeps of short episodes 0.85 to 0.89, as commands begin with a step. Chosen: two joints of
#: one finger meet what is in its way together.
FOLLOWS, JOINTS = 0.8, 3
#: A shift against the scene is whole rows to within this, with this spread over episodes.
ROUNDING_ROWS, STEADY_ROWS = 0.25, 0.25
#: Rows of an episode that are replayed in the scene.
REPLAYED_ROWS = 400
REMEDY = "check which command a row holds: `action: next` or `previous` in the map; move the commands"


@dataclass(frozen=True)
class _Lag:
    """Rows by which joints come behind their commands in an episode.

    Attributes
    ----------
    id, task : str
    rows : float
        All together.
    by_joint : dict of str to float
        Those of the joints that have a say, by name.
    scene : float
        The same of the scene's joints under these commands; NaN without a scene.
    rate_hz : float
    """

    id: str
    task: str
    rows: float
    by_joint: dict[str, float]
    scene: float
    rate_hz: float


def _gather(view: EpisodeView) -> _Lag | None:
    """Return the lag of an episode; None where its joints do not tell."""
    lags = joint_lags(view)
    if lags is None or not np.isfinite(lags.rows):
        return None
    task = (view.meta.task if view.meta else None) or ""
    follows = np.isfinite(lags.by_joint) & (lags.correlations > FOLLOWS)
    by_joint = {name: float(rows) for name, rows, f in zip(lags.names, lags.by_joint, follows, strict=True) if f}
    return _Lag(view.id, task, lags.rows, by_joint, _scene_lag(view), view.rate_hz)


def _scene_lag(view: EpisodeView) -> float:
    """Return the rows by which the scene's joints come behind the same commands; NaN where that cannot be played."""
    scene, joint, command = view.scene, view.values("joint_position"), view.values("action")
    if scene is None or joint is None or command is None or view.meta is None:
        return np.nan
    has_scene_names = (
        view.meta.joint_names == scene.file.joints and view.meta.actuator_names == scene.file.actuator_names
    )
    has_scene_rate = abs(view.rate_hz / scene.file.rate_hz - 1) < 0.02
    if not has_scene_names or not has_scene_rate or not np.isfinite(command).all() or not np.isfinite(joint[0]).all():
        return np.nan
    from candata.simulate import rollout

    qpos = np.array(scene.model.qpos0, float)
    qpos[scene.joint_qpos] = joint[0]
    pose = view.complete_values("object_pose")
    if scene.object_id is not None and pose is not None and np.isfinite(pose[0]).all():
        qpos[scene.object_qpos : scene.object_qpos + 7] = pose[0]
    replayed_commands = command[:REPLAYED_ROWS]
    trajectory = rollout(scene, replayed_commands[None], qpos[None], np.zeros((1, scene.model.nv)), [()])
    scene_joint = np.full_like(joint, np.nan)
    scene_joint[: len(replayed_commands)] = trajectory.readings["joint_position"][0]
    return lag(view, slice(0, len(replayed_commands)), scene_joint)


def _judge(lags: Sequence[_Lag]) -> Iterator[Finding]:
    """Yield a set whose joints lead, or are shifted against the scene's, and episodes apart from their kind."""
    rows = np.array([episode.rows for episode in lags])
    median_rows, rate = float(np.median(rows)), lags[0].rate_hz
    if median_rows < LEADS and (rows < 0).mean() >= LEADING_SHARE:
        problem = "joints move before their commands"
        yield _lag_finding(
            "warning" if median_rows > -1.5 else "error",
            problem,
            f"by {-median_rows:.1f} rows ({-1e3 * median_rows / rate:.0f} ms)",
            lag_rows=median_rows,
            episodes=len(lags),
        )
        return
    scene_shifts = np.array([episode.rows - episode.scene for episode in lags if np.isfinite(episode.scene)])
    if len(scene_shifts) >= KIND and spread(scene_shifts) < STEADY_ROWS:
        yield from _scene_shift_findings(float(np.median(scene_shifts)), rate, len(scene_shifts))
    yield from _outlier_findings(lags)


def _scene_shift_findings(rows: float, rate_hz: float, episodes: int) -> Iterator[Finding]:
    """Yield that joints come whole rows earlier than the scene's, or later: that may be a delay too."""
    if abs(rows) < 1 - ROUNDING_ROWS or abs(rows - round(rows)) > ROUNDING_ROWS:
        return
    earlier = rows < 0
    problem = f"joints react {'earlier' if earlier else 'later'} than the scene's, by whole rows"
    detail = f"{abs(rows):.2f} rows ({1e3 * abs(rows) / rate_hz:.0f} ms)"
    detail += ": commands are logged late" if earlier else ": a delay, or commands logged early"
    yield _lag_finding("warning" if earlier else "info", problem, detail, shift_rows=rows, episodes=episodes)


def _outlier_findings(lags: Sequence[_Lag]) -> Iterator[Finding]:
    """Yield episodes in which all joints that have a say come as many rows apart from the others of their kind.

    Commands that are logged late shift all joints alike; what a finger meets shifts those that meet it.
    """
    usual_rows = {key: float(np.median(rows)) for key, rows in _rows_by_kind(lags).items() if len(rows) >= KIND}
    shifts = {
        timing.id: np.array(
            [
                rows - usual_rows[timing.task, name]
                for name, rows in timing.by_joint.items()
                if (timing.task, name) in usual_rows
            ]
        )
        for timing in lags
    }
    compared_lags = [timing for timing in lags if len(shifts[timing.id]) >= JOINTS]
    if len(compared_lags) < FEWEST:
        return
    median_shifts = np.array([np.median(shifts[timing.id]) for timing in compared_lags])
    least_shift = max(APART_ROWS, SPREADS * spread(median_shifts))
    for timing, shift in zip(compared_lags, median_shifts.tolist(), strict=True):
        if (np.abs(shifts[timing.id]) > least_shift).all() and np.ptp(shifts[timing.id]) < APART_ROWS:
            problem, others_rows = "commands are shifted against those of the other episodes", timing.rows - shift
            yield _lag_finding(
                "warning",
                problem,
                f"joints come {timing.rows:.1f} rows behind, in the others {others_rows:.1f}",
                timing.id,
                lag_rows=timing.rows,
                others_rows=others_rows,
                others_spread_rows=spread(median_shifts),
            )


def _rows_by_kind(lags: Sequence[_Lag]) -> dict[tuple[str, str], list[float]]:
    """Return the rows by which each joint comes behind in the episodes of each task."""
    out: dict[tuple[str, str], list[float]] = defaultdict(list)
    for timing in lags:
        for name, rows in timing.by_joint.items():
            out[timing.task, name].append(rows)
    return out


def _lag_finding(level: Level, problem: str, detail: str, episode: str | None = None, **evidence: float) -> Finding:
    """Return a finding of the commands."""
    text = f"{problem}: {detail}"
    return Finding(
        level,
        "command_lag",
        text,
        episode=episode,
        channel="action",
        problem=problem,
        evidence=round_evidence(evidence),
        remedy=REMEDY,
    )


RULE = Rule(
    meaning="joints move after their commands",
    gather=_gather,
    judge=_judge,
    needs=("joint_position", "action"),
    idle_reason="no joint follows a command of its name closely enough to time it",
)
