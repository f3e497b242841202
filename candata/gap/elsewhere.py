"""A fault taken for that of another element: of all of them, or of the one that promises most."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.added import residuals_at
from candata.gap.candidates import Candidate, candidate, elements_of, is_on_slides, local_candidates
from candata.gap.compare import RIVALS, UNSURE, is_elsewhere, is_tied
from candata.gap.own_floor import rescored
from candata.gap.refine import joint
from candata.gap.screen import respond
from candata.gap.search import Fit, Members, Problem, fit_one
from candata.gap.shortlist import brief
from candata.gap.sparse import pruned
from candata.gap.trials import least_worth, sharpest
from candata.gap.worth import LARGEST, MOST, OPEN, extra_of, left_by, settles, worth_adding

Array = NDArray[np.float64]


def moved(problem: Problem, best: Fit) -> Fit | None:
    """Return the set with a fault taken for that of other elements, fewer or more, if that explains more.

    None where it does not. Under other causes a fault first shows on the element that they spare, or that moves what it
    moves; what made up for the wrong place is dropped with it. (A finger's motors, all limited to 0.19 N m, were named
    as one of them, which left 0.56 floors: of the finger as a whole 0.22 N m had been read off. From another seed they
    were named as all motors, limited to 0.2 N m, which left 0.42.) Of many only those are asked that are worth most.
    """
    if left_by(best) < OPEN:
        return None
    base = problem.score.loss(problem.nominal)
    # First those of one element: what is everywhere may only make up for one that is in the wrong place.
    asked = best.members if len(best.members) <= LARGEST else least_worth(brief(problem)[0], best, ())[-LARGEST:]
    for c, u in sorted(asked, key=lambda m: m[0].element is None):
        others = tuple(m for m in best.members if m[0].name != c.name)
        all_over: Members = ()
        if c.element is None:
            places = narrower(problem, others, c, u)
        else:
            all_over = () if is_on_slides(c, problem.replayer.scene) else (everywhere(problem, c, u),)
            places = (*all_over, *groups(problem, c, u), *neighbour(problem, others, c))
        light = [joint(problem, (*others, place), base, widths=()) for place in places]
        fit = sharpest(problem, [f for f in light if is_tied(f, best, UNSURE)])
        if fit is not None and _is_better(best, fit, problem.recs.tasks):
            holding = [v for v, _ in groups(problem, c, u)] if c.element is not None else []
            return pruned(problem, _of_fewer_numbers(problem, fit, holding), base)
        if all_over and _foretells(problem, best, light[0]):
            return light[0]
    return _spread_together(problem, best)


def _of_fewer_numbers(problem: Problem, fit: Fit, variants: Sequence[Candidate]) -> Fit:
    """Return the set with an effect on fewer elements than in `fit`, if its own numbers alone explain as much.

    (The offsets of a finger's two joints were named as those of all six, four of which were 0.01 rad at most.)
    """
    base = problem.score.loss(problem.nominal)
    for v in sorted(variants, key=lambda v: v.size):
        whole, at = next(m for m in fit.members if m[0].name == v.name)
        if v.size >= whole.size or not whole.own[v.own].all():
            continue
        members = tuple((v, at[v.own[whole.own]]) if c is whole else (c, u) for c, u in fit.members)
        if is_tied(joint(problem, members, base, widths=()), fit, UNSURE):
            fewer = joint(problem, members, base)
            if is_tied(fewer, fit):
                return fewer
    return fit


def _spread_together(problem: Problem, best: Fit) -> Fit | None:
    """Return the set with all effects of one element or group on all elements, if it explains more; else None.

    For where each alone goes nowhere. (Of contacts that all were soft and bounced, both effects were named of the
    fingertips beside a mass centre, which left 1.1 floors.)
    """
    scene, base = problem.replayer.scene, problem.score.loss(problem.nominal)
    elements = [c.element for c, _ in best.members if c.element is not None and not is_on_slides(c, scene)]
    for element in sorted({e for e in elements if elements.count(e) > 1}):
        spread = tuple(
            everywhere(problem, c, u) if c.element == element and not is_on_slides(c, scene) else (c, u)
            for c, u in best.members
        )
        light = joint(problem, spread, base, widths=()) if len({c.name for c, _ in spread}) == len(spread) else None
        if light is not None and is_tied(light, best, UNSURE):
            fit = joint(problem, light.members, base)
            if _is_better(best, fit, problem.recs.tasks):
                return pruned(problem, fit, base)
    return None


def _foretells(problem: Problem, best: Fit, other: Fit) -> bool:
    """Tell whether another set, as good by the spread of `best`, leaves half of it at most by that of its own world.

    Where contact is chaos everywhere, a fault of the fingertips alone foretells more than is there to foretell. (Of
    contacts that all bounce, those of the fingertips left 0.13 floors less by the nominal spread, and 0.4 more by that
    of their own worlds.)
    """
    return is_tied(other, best, UNSURE) and left_by(rescored(problem, other)[1]) <= MOST * left_by(best)


def _is_better(best: Fit, other: Fit, tasks: Sequence[str]) -> bool:
    """Tell whether another set explains clearly more: as much as one more name must, or surely most of what is left.

    (Of 22 floors, the offsets of five joints in place of that of one left 0.2 of 0.9, less than a name is worth.)
    """
    return worth_adding(extra_of(best, other), best.gain) or settles(best, other, tasks)


def everywhere(problem: Problem, c: Candidate, u: Array) -> tuple[Candidate, Array]:
    """Return the effect of which `c` is the variant on one element, as strong there."""
    return _spread(candidate(c.name, problem.replayer.scene), c, u)


def narrower(problem: Problem, others: Members, c: Candidate, u: Array) -> Members:
    """Return an effect of one number on all elements, as strong, on those alone that leave least beside the others.

    None of a vector's: its fit has each element's own numbers.
    """
    if c.choices or c.size > 1:
        return ()
    part, _ = brief(problem)
    variants = local_candidates(c, problem.replayer.scene)
    zs = part.residuals([part.setting((*others, (v, u))) for v in variants]) if variants else []
    order = np.argsort([float(part.score.loss(z).mean()) for z in zs])
    return tuple((variants[i], u) for i in order[:RIVALS])


def groups(problem: Problem, c: Candidate, u: Array) -> Members:
    """Return the effect of which `c` is the variant on one element, as strong, on each group that holds it."""
    scene = problem.replayer.scene
    every = local_candidates(candidate(c.name, scene), scene)
    own = set(elements_of(c, scene))
    return tuple(_spread(v, c, u) for v in every if own < set(elements_of(v, scene)))


def _spread(wider: Candidate, c: Candidate, u: Array) -> tuple[Candidate, Array]:
    """Return an effect with the numbers `u` of one of its elements, others as they are; a scalar is as strong."""
    at = wider.neutral.copy()
    at[c.own[wider.own]] = u
    return wider, at


def neighbour(problem: Problem, others: Members, c: Candidate, apart: bool = False) -> Members:
    """Return the same effect on the other element that promises most beside the others; nothing where none does.

    Only on one that shares nothing with the element of `c`, where they are to lie `apart`.
    """
    scene = problem.replayer.scene
    here = residuals_at(problem, others)
    every = [v for v in local_candidates(candidate(c.name, scene), scene) if v.element != c.element]
    variants = [v for v in every if not apart or is_elsewhere(v, c, scene)]
    base = problem.score.loss(here)
    fits = [fit_one(problem, v, response, base) for v, response in respond(problem, here, variants, others)[0]]
    best = max(fits, key=lambda f: f.gain, default=None)
    return best.members if best is not None and best.gain > 0 else ()
