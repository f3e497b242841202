"""What a report proposes to record next, in words and as commands."""

from __future__ import annotations

import numpy as np

from candata.effects import effect
from candata.errors import DataError
from candata.gap.data.recordings import Recordings
from candata.gap.fit.problem import Problem
from candata.gap.fit.stage import MATTERS
from candata.gap.search.attribution import Attribution
from candata.gap.validation.closure import separating_task
from candata.gap.verdict.next_motion import RIVALS, Choice, rivals_of, separating_motion, usual_motions
from candata.policies import Motion
from candata.scenes import Scene
from candata.schema.report import NextMotion

MOTION_FILE = "motion.parquet"
#: Episodes of a proposed motion to record. What it shows is spread over all episodes: where m of them tell two causes
#: apart and the others do not at all, the mean difference is at least sqrt(m) of its standard errors.
PLAYED = 8
#: Length of a motion where no recording says how long one is [s].
USUAL_S = 3.2
Proposal = tuple[NextMotion | None, tuple[Motion, ...]]


def separating(problem: Problem, found: Attribution) -> Proposal:
    """Return the motion that separates tied candidates best, in words and as commands.

    Where nothing can be commanded (a toss), or no motion stays within the limits, it is the recorded task in which
    they differ most, without commands.

    Parameters
    ----------
    problem : Problem
        In units of the floor by which the candidates were judged.
    found : Attribution
        Two or more tied, the best first.
    """
    labels = tuple(t.labels[0] for t in found.tied[:RIVALS])
    choice = _choice(problem, found)
    if choice is None:
        task = separating_task(problem, found)
        return NextMotion(name=task or "more of the same motion", separates=labels[:2]), ()
    words = NextMotion(
        name=choice.motion.name,
        file=MOTION_FILE,
        separates=labels,
        expected_separation=round(choice.separation, 3),
        reason=_reason(choice),
    )
    return words, (choice.motion,)


def _choice(problem: Problem, found: Attribution) -> Choice | None:
    """Return the motion that separates what is tied; None where there is none, or a cause follows the recording."""
    if any(effect(c.name).follows for t in found.tied for c, _ in t.members):
        return None
    scene = problem.replayer.scene
    rivals = rivals_of(problem, [problem.setting(t.members) for t in found.tied])
    length = float(np.median(problem.recs.lengths)) / scene.file.rate_hz
    try:
        return separating_motion(rivals, length, problem.stream("next motion", *rivals.sets))
    except DataError:
        # A candidate at its bound may leave the finite numbers in a motion that was never recorded.
        return None


def _reason(found: Choice) -> str:
    """Return why this motion, and what to expect of it."""
    compared = f"best of {found.tried} motions" if found.tried > 1 else "the only motion within the limits"
    size = f"{compared}: a wrong cause would be {found.separation:.2g} floors worse"
    usual = f"in the usual motions {found.usual:.2g}"
    return f"play it {PLAYED} times and diagnose old and new together; {size}, {usual}" + (
        "" if found.separation >= MATTERS else "; that is little, and it may not decide"
    )


def usual_proposal(scene: Scene, recs: Recordings, fewest: int) -> Proposal:
    """Return the scene's usual motions, of which more episodes are needed; nothing where nothing can be commanded.

    Parameters
    ----------
    scene : Scene
    recs : Recordings
        What there is.
    fewest : int
        Episodes on which anything is decided.
    """
    length = float(np.median(recs.lengths)) / scene.file.rate_hz if len(recs) else USUAL_S
    motions = usual_motions(scene, max(length, USUAL_S))
    if not motions:
        return None, ()
    count = fewest - len(recs) if len(recs) < fewest else fewest
    reason = f"at least {count} more episode{'s' if count != 1 else ''}, the object put back before each"
    return NextMotion(name="the usual motions in turn", file=MOTION_FILE, reason=reason), motions
