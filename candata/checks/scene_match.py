"""Rule: units and orders are the scene's: joints, commands, forces and poses do what the scene's do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._view import EpisodeView
from candata.errors import CandataError, DataError, RateError
from candata.gap.data.faults import fault_of
from candata.gap.data.recordings import Recordings, recordings
from candata.gap.mismatch.check import compared
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.replay.replayer import Replayer
from candata.scenes import Scene
from candata.schema.episode import Episode

NAME = "scene_match"
#: Kinds of what `mismatch` notes that say nothing of the data being wrong.
NO_FAULT = ("no_repeats", "still")
#: Kinds that are worth a look where they are not sure; others may be the world's own doing.
DOUBTFUL = (
    "joint_unit",
    "command_unit",
    "force_unit",
    "force_timing",
    "pose_unit",
    "swapped_fingertips",
    "broken_episodes",
)


def _sample(views: Sequence[EpisodeView], scene: Scene) -> Iterator[Finding]:
    """Yield what no physics explains between some episodes and the scene under their commands."""
    episodes = [e for e in map(_episode, views) if e is not None]
    if episodes and not any(_of_scene(e, scene) for e in episodes):
        yield Finding(
            "unknown", NAME, "the joints are none of the scene's", problem="the joints are none of the scene's"
        )
        return
    usual_length = float(np.median([len(e) for e in episodes])) if episodes else 0.0
    faults = [fault_of(scene, e, usual_length) for e in episodes]
    yield from (_fault(fault) for fault in faults if isinstance(fault, RateError))
    recs = _recordings(scene, [e for e, fault in zip(episodes, faults, strict=True) if fault is None])
    if isinstance(recs, str):
        reason = next((f.problem for f in faults if f is not None and not isinstance(f, RateError)), recs)
        if not any(isinstance(f, RateError) for f in faults):
            yield Finding("unknown", NAME, reason, problem=reason)
        return
    comparison = compared(Replayer(scene), recs)
    yield from (_finding(mismatch) for mismatch in comparison.findings if mismatch.kind not in NO_FAULT)
    if comparison.undecidable:
        reason = f"the object and the fingertips do too little to tell {'; '.join(comparison.undecidable)}"
        yield Finding("unknown", NAME, reason, problem=reason)


def _episode(view: EpisodeView) -> Episode | None:
    """Return what is stored as an episode; None where it is none: other rules say why."""
    try:
        return Episode(view.raw.meta(), {n: np.asarray(a) for n, a in view.raw.arrays.items()})
    except (CandataError, ValueError):
        return None


def _of_scene(episode: Episode, scene: Scene) -> bool:
    """Tell whether an episode may be of the scene: it shares a joint's name, or has as many joints, or none."""
    names = episode.meta.joint_names
    return not names or len(names) == len(scene.file.joints) or bool(set(names) & set(scene.file.joints))


def _recordings(scene: Scene, episodes: list[Episode]) -> Recordings | str:
    """Return the episodes as recordings, or why they cannot be compared."""
    if not episodes:
        return "no episode that can be played in the scene"
    try:
        return recordings(scene, episodes)
    except DataError as error:
        return error.problem


def _fault(error: DataError) -> Finding:
    """Return the finding that an episode cannot be played in the scene."""
    text = f"{error.problem}: expected {error.expected}, found {error.found}"
    return Finding(
        "error",
        NAME,
        text,
        episode=error.where.episode,
        channel=error.where.channel,
        problem=error.problem,
        remedy=error.fix or "",
    )


def _finding(mismatch: RecordingMismatch) -> Finding:
    """Return a mismatch as a finding: an error where it is sure."""
    level: Level = "error" if mismatch.definite else "warning" if mismatch.kind in DOUBTFUL else "info"
    text = f"{mismatch.problem}: expected {mismatch.expected}, found {mismatch.found}"
    return Finding(
        level,
        NAME,
        text,
        channel=mismatch.channel,
        problem=mismatch.problem,
        evidence={"kind": mismatch.kind},
        remedy=mismatch.fix,
    )


RULE = Rule(meaning="units, orders and rate are the scene's", sample=_sample, scene=True)
