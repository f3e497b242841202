"""Which: screen candidates by responses, refine the best by rollouts, choose on held-out episodes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from candata.gap.fit.acceptance import LEFT, MOST, left_by
from candata.gap.fit.comparison import null_level, tied_with
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.problem import Problem
from candata.gap.fit.stage import Stage
from candata.gap.fit.world_floor import Grown, judged
from candata.gap.force.remedy import Doubt, LoneForce, Mended
from candata.gap.measure.score import Score
from candata.gap.run.pace import AGAIN, REST, SHARPEN
from candata.gap.screening.episodes import looked_into
from candata.gap.screening.look import as_simulated, look, look_again, narrowed, sharpened, unheld
from candata.gap.screening.refinement import joint, polished
from candata.gap.screening.shortlist import WORTH, gains_share
from candata.gap.search.agenda import aliases, begun, search
from candata.gap.search.episode_counts import alone, recentred
from candata.gap.search.outlook import further
from candata.scenes.traits import is_toss

#: Share of the gap that the best effect alone must leave for sets to be tried before it is compared sharply with its
#: rivals, and that a set must leave for episodes to be counted. Chosen: a sharper fit seldom gains as much.
FAR = 0.25
#: Floors that must be left for every effect to be simulated on the recording, and the share of what the first search
#: leaves to which the second one must come down to replace it. Chosen.
SETTLED, SMALLER = 0.5, 0.8


@dataclass(frozen=True)
class Attribution:
    """What the search found.

    Attributes
    ----------
    first : Stage
        Every candidate alone.
    chosen : Fit or None
        The set that passes, or None.
    tied : tuple of Fit
        Fits whose first members the held-out episodes cannot tell apart, the best first: single ones, or sets of which
        the other members are the same.
    score : Score
        In units of the floor of the chosen world.
    remains : bool
        Whether the held-out loss of the chosen set (or of the nominal scene) lies above the nulls, and more than many
        little things remain.
    rivals : tuple of Fit
        Sets with one member of the chosen one exchanged that the held-out episodes cannot tell from it.
    force : Mended or None
        A force that explains clearly more than what was found, where that ended the search.
    doubt : Doubt or None
        What one force closes in the place of effects; None of tosses.
    """

    first: Stage
    chosen: Fit | None
    tied: tuple[Fit, ...]
    score: Score
    remains: bool
    rivals: tuple[Fit, ...] = ()
    force: Mended | None = None
    doubt: Doubt | None = None


def attribute(problem: Problem) -> Attribution:
    """Return the effects that explain the gap, chosen on held-out episodes.

    Where a search by signatures leaves most of the gap, or names nothing, the episodes are counted that one value
    explains, and then every effect is simulated on the recording: in a world far from the nominal one, or where contact
    is chaos, signatures say little of what an effect does there. Where one force explains clearly more than what is
    found, no more is looked for.
    """
    # A toss has no motion that a force could be read off.
    doubt = None if is_toss(problem.replayer.scene) else Doubt(LoneForce(problem))
    return replace(_attributed(problem, doubt), doubt=doubt)


def _attributed(problem: Problem, doubt: Doubt | None) -> Attribution:
    """Return what the searches find, one after another where they leave much."""
    found = _search(problem, look(problem), doubt)
    if found.force:
        return found
    share, floors = _left(problem, found)
    little = found.chosen is not None and (share <= MOST or floors < SETTLED)
    if is_toss(problem.replayer.scene):
        return found
    # A chaotic world's floor may be so high that no gap remains: there too a value may explain more episodes.
    much = share > FAR and (found.remains or floors > LEFT)
    uneven = _uneven(found.first, recentred(problem, found.first, found.chosen)) if much else None
    if uneven is None and found.chosen and len(found.tied) == 1:
        uneven = _uneven(found.first, alone(problem, found.chosen, found.score))
    if uneven or little or not found.remains:
        return uneven or found
    problem.pace.say("simulating every effect on the recording itself", AGAIN, after=REST.most)
    seeing = _looked_into(problem, found)
    if seeing is None:
        return found
    problem, held = seeing
    first = look(problem, found.first)
    if not found.chosen and first.best_gain < WORTH * float((first.base - 1).mean()):
        # What the few most telling episodes promised, the others do not keep.
        return found
    other = _search(problem, first, _doubt_beyond(doubt, replace(problem, score=found.score), found.chosen))
    if other.force:
        return other
    uneven = None if held else _uneven(first, recentred(problem, first, other.chosen))
    if uneven:
        return uneven
    left, _ = _left(problem, other)
    # Of a gap of less than `LEFT` no share is told: there a set that passes is better than none.
    return other if left < SMALLER * share or (share == 0 and other.chosen is not None) else found


def _looked_into(problem: Problem, found: Attribution) -> tuple[Problem, Members] | None:
    """Return the problem in which all is simulated on the recording, and what was held where an effect promised enough.

    Asked beside the best effect where something was named, and then without it, if it explains enough to hide another;
    None where neither promises a share of what is left.
    """
    first = found.first.fits[0] if found.chosen else None
    best = first.members if first else ()
    hides = first is not None and first.gain > WORTH * float((found.first.base - 1).mean())
    left = problem.residuals([problem.setting(found.chosen.members if found.chosen else ())])[0]
    for held in [best, ()] if hides else [best]:
        here = problem.residuals([problem.setting(held)])[0]
        deeper = looked_into(problem, here)
        if gains_share(deeper, here, unheld(deeper, held), held, here if held else left):
            return deeper, held
    return None


def _counting(problem: Problem, first: Stage, remains: bool) -> tuple[Stage, Fit | None]:
    """Return the first look with its best at its sharpest, where that decides, and what of it counts; None of nothing.

    Within the nulls' range a blunt fit shows half of a faint effect, and the luck of all.
    """
    best, tasks = first.passing(), problem.recs.tasks
    if best is None or remains or first.is_plain(best, tasks):
        return first, best
    best = polished(problem, best, first.base)
    first = replace(first, fits=(best, *first.fits[1:]))
    return first, best if first.is_plain(best, tasks) else None


def _uneven(first: Stage, found: tuple[Fit, Problem] | None) -> Attribution | None:
    """Return what one scalar explains in a chaotic world whose floor leaves no gap; None where none does."""
    if found is None:
        return None
    best, world = found
    return Attribution(first, best, (best,), world.score, False)


def _left(problem: Problem, found: Attribution) -> tuple[float, float]:
    """Return what is left of the loss above the floor on held-out episodes: its share (0 of little), and in floors."""
    before = float(found.score.loss(found.score.normal(problem.raw)).mean()) - 1
    after = float(found.chosen.evidence.loss.mean()) - 1 if found.chosen else before
    return after / before if before > LEFT else 0.0, after


def _search(problem: Problem, first: Stage, doubt: Doubt | None = None) -> Attribution:
    """Return what the search finds that begins with the evidence of every candidate alone, or where a doubt ends it."""
    problem.sofar.first = first
    remains = bool(problem.score.loss(problem.nominal).mean() > null_level(problem.score))
    if remains and first.faint and first.passing() is None and not problem.simulated:
        # Before the cause is called unknown, all that could explain it is looked at on every episode.
        problem.pace.told("looking at more effects on every episode")
        first = look_again(problem, first)
    first, best = _counting(problem, first, remains)
    if best is None:
        return Attribution(first, None, (), problem.score, remains)
    is_far = left_by(best) > FAR * float((first.base - 1).mean()) and not problem.plays_all
    several = begun(problem, best, as_simulated(problem, first)) if is_far else None
    if several is None:
        # Of tosses it takes up to twice as long.
        longer = SHARPEN.most if is_toss(problem.replayer.scene) else 0.0
        problem.pace.say("comparing what is best so far", SHARPEN, after=further(problem, 1) + longer)
        first = problem.sofar.first = sharpened(problem, narrowed(problem, problem.nominal, first))
    best = first.fits[0]
    force: list[Mended] = []

    def ends(world: Problem, fit: Fit) -> bool:
        found = doubt.of(world, world.where(fit)) if doubt and left_by(fit) > LEFT else None
        force.extend([found] if found else [])
        return found is not None

    state = search(problem, several or best, as_simulated(problem, first), ends)
    grown = state.incumbent, state.world, state.remains
    if force:
        return _ended(first, grown, force[0])
    chosen, world, remains = _with_measured(*grown)
    if several is None and chosen.labels == best.labels:
        tied = tied_with(best, first.fits, first.reachable)
        return Attribution(first, chosen, (chosen, *tied[1:]), world.score, remains)
    rivals = state.rivals() if chosen is state.incumbent else []
    tied = aliases(world, chosen, rivals) or [chosen]
    return Attribution(first, chosen, tuple(tied), world.score, remains, tuple(rivals))


def _with_measured(best: Fit, problem: Problem, remains: bool) -> tuple[Fit, Problem, bool]:
    """Return the set joined by what was measured directly: it needs no gain to be believed."""
    new = tuple((c, u) for c, u in problem.measured if c.name not in {m.name for m, _ in best.members})
    if not new:
        return best, problem, remains
    return judged(problem, joint(problem, (*best.members, *new), problem.score.loss(problem.nominal)))


def _ended(first: Stage, grown: Grown, force: Mended) -> Attribution:
    """Return what was found where a force ends the search."""
    chosen, world, remains = grown
    return Attribution(first, chosen, (chosen,), world.score, remains, force=force)


def _doubt_beyond(doubt: Doubt | None, world: Problem, chosen: Fit | None) -> Doubt | None:
    """Return a doubt that must explain more than what was chosen, in units of the floor of its `world`, too."""
    return doubt.beyond(world, world.at(chosen.members)) if doubt and chosen else doubt
