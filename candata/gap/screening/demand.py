"""Which signatures diagnoses of the same commands look at, before any of them is known."""

from __future__ import annotations

from typing import Literal

from candata.gap.fit.candidates import candidates, local_candidates
from candata.gap.fit.problem import Problem
from candata.gap.replay.replayer import EffectSet, needs_simulation
from candata.gap.screening.episodes import brief, first_look
from candata.gap.screening.signature_screen import screening
from candata.scenes.traits import is_toss

#: What is wanted: what every diagnosis looks at first; also what most of many diagnoses come to need; everything.
Depth = Literal["first", "most", "all"]


def wanted(problem: Problem, depth: Depth) -> list[tuple[Problem, EffectSet]]:
    """Return the signatures to keep, each with the problem whose library keeps it; none for tosses.

    First comes what every diagnosis looks at first, all effects on a few episodes or half of them; then their variants
    on one element there, and the effects on every episode; then these variants on every episode.
    """
    scene = problem.replayer.scene
    if is_toss(scene):
        return []
    possible = [c for c in candidates(scene, problem.recs.channels) if c.name not in problem.ruled_out]
    few, _ = brief(problem)
    rounds = [(first_look(problem)[0], possible)]
    if depth != "first":
        variants = [v for c in possible for v in local_candidates(c, scene)]
        rounds += [(few, variants)] if few is problem else [(few, variants), (problem, possible)]
        rounds += [(problem, variants)] if depth == "all" and few is not problem else []
    asked = [(part, part.setting([(c, u)])) for part, some in rounds for c in some for u in screening(c, part)]
    return [(part, effects) for part, effects in asked if needs_simulation(effects)]
