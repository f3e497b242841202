"""Rule: joints move after their commands: by as much in each episode, and as the scene's do."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._lags import followed, lag
from candata.checks._signal import spread
from candata.checks._view import View, rounded

#: Rows by which joints may seem to lead: half a row is rounding of the lag.
LEADS = -0.5
#: Share of episodes that must lead before the set does.
MOST = 0.7
#: An episode is apart from others of its kind by so many rows and so many spreads; fewest of a kind, and of the set.
APART, SPREADS, KIND, FEWEST = 0.75, 8.0, 3, 6
#: Correlation of its speed with its command's from which a joint has a say, and fewest joints that must say the same.
#: Measured on a hand: free sweeps of short episodes 0.85 to 0.89, as commands begin with a step. Chosen: two joints of
#: one finger meet what is in its way together.
FOLLOWING, JOINTS = 0.8, 3
#: A shift against the scene is whole rows to within this, with this spread over episodes.
WHOLE, STEADY = 0.25, 0.25
#: Rows of an episode that are replayed in the scene.
REPLAYED = 400
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


def _gather(view: View) -> _Lag | None:
    """Return the lag of an episode; None where its joints do not tell."""
    lags = followed(view)
    if lags is None or not np.isfinite(lags.rows):
        return None
    task = (view.meta.task if view.meta else None) or ""
    follows = np.isfinite(lags.by_joint) & (lags.alike > FOLLOWING)
    by_joint = {name: float(rows) for name, rows, f in zip(lags.names, lags.by_joint, follows, strict=True) if f}
    return _Lag(view.id, task, lags.rows, by_joint, _of_scene(view), view.rate_hz)


def _of_scene(view: View) -> float:
    """Return the rows by which the scene's joints come behind the same commands; NaN where that cannot be played."""
    scene, joint, command = view.scene, view.values("joint_position"), view.values("action")
    if scene is None or joint is None or command is None or view.meta is None:
        return np.nan
    same = view.meta.joint_names == scene.file.joints and view.meta.actuator_names == scene.file.actuator_names
    rate = abs(view.rate_hz / scene.file.rate_hz - 1) < 0.02
    if not same or not rate or not np.isfinite(command).all() or not np.isfinite(joint[0]).all():
        return np.nan
    from candata.simulate import rollout

    qpos = np.array(scene.model.qpos0, float)
    qpos[scene.joint_qpos] = joint[0]
    pose = view.whole("object_pose")
    if scene.object_id is not None and pose is not None and np.isfinite(pose[0]).all():
        qpos[scene.object_qpos : scene.object_qpos + 7] = pose[0]
    some = command[:REPLAYED]
    played = rollout(scene, some[None], qpos[None], np.zeros((1, scene.model.nv)), [()])
    own = np.full_like(joint, np.nan)
    own[: len(some)] = played.readings["joint_position"][0]
    return lag(view, slice(0, len(some)), own)


def _judge(seen: Sequence[_Lag]) -> Iterator[Finding]:
    """Yield a set whose joints lead, or are shifted against the scene's, and episodes apart from their kind."""
    rows = np.array([one.rows for one in seen])
    middle, rate = float(np.median(rows)), seen[0].rate_hz
    if middle < LEADS and (rows < 0).mean() >= MOST:
        problem = "joints move before their commands"
        yield _found(
            "warning" if middle > -1.5 else "error", problem, f"by {-middle:.1f} rows ({-1e3 * middle / rate:.0f} ms)",
            lag_rows=middle, episodes=len(seen),
        )  # fmt: skip
        return
    apart = np.array([one.rows - one.scene for one in seen if np.isfinite(one.scene)])
    if len(apart) >= KIND and spread(apart) < STEADY:
        yield from _shifted(float(np.median(apart)), rate, len(apart))
    yield from _apart(seen)


def _shifted(rows: float, rate_hz: float, episodes: int) -> Iterator[Finding]:
    """Yield that joints come whole rows earlier than the scene's, or later: that may be a delay too."""
    if abs(rows) < 1 - WHOLE or abs(rows - round(rows)) > WHOLE:
        return
    earlier = rows < 0
    problem = f"joints react {'earlier' if earlier else 'later'} than the scene's, by whole rows"
    detail = f"{abs(rows):.2f} rows ({1e3 * abs(rows) / rate_hz:.0f} ms)"
    detail += ": commands are logged late" if earlier else ": a delay, or commands logged early"
    yield _found("warning" if earlier else "info", problem, detail, shift_rows=rows, episodes=episodes)


def _apart(seen: Sequence[_Lag]) -> Iterator[Finding]:
    """Yield episodes in which all joints that have a say come as many rows apart from the others of their kind.

    Commands that are logged late shift all joints alike; what a finger meets shifts those that meet it.
    """
    usual = {key: float(np.median(rows)) for key, rows in _kinds(seen).items() if len(rows) >= KIND}
    off = {
        timing.id: np.array(
            [rows - usual[timing.task, name] for name, rows in timing.by_joint.items() if (timing.task, name) in usual]
        )
        for timing in seen
    }
    compared = [timing for timing in seen if len(off[timing.id]) >= JOINTS]
    if len(compared) < FEWEST:
        return
    middle = np.array([np.median(off[timing.id]) for timing in compared])
    least = max(APART, SPREADS * spread(middle))
    for timing, shift in zip(compared, middle.tolist(), strict=True):
        if (np.abs(off[timing.id]) > least).all() and np.ptp(off[timing.id]) < APART:
            problem, others = "commands are shifted against those of the other episodes", timing.rows - shift
            yield _found(
                "warning",
                problem,
                f"joints come {timing.rows:.1f} rows behind, in the others {others:.1f}",
                timing.id,
                lag_rows=timing.rows,
                others_rows=others,
                others_spread_rows=spread(middle),
            )


def _kinds(seen: Sequence[_Lag]) -> dict[tuple[str, str], list[float]]:
    """Return the rows by which each joint comes behind in the episodes of each task."""
    out: dict[tuple[str, str], list[float]] = defaultdict(list)
    for timing in seen:
        for name, rows in timing.by_joint.items():
            out[timing.task, name].append(rows)
    return out


def _found(level: Level, problem: str, detail: str, episode: str | None = None, **evidence: float) -> Finding:
    """Return a finding of the commands."""
    text = f"{problem}: {detail}"
    return Finding(level, "command_lag", text, episode, "action", None, problem, (), rounded(evidence), REMEDY)


RULE = Rule(
    meaning="joints move after their commands", gather=_gather, judge=_judge, needs=("joint_position", "action"),
    idle="no joint follows a command of its name closely enough to time it",
)  # fmt: skip
