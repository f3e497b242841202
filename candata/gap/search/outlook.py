"""Outlook: what a search is going to take, said before it begins."""

from __future__ import annotations

from candata.gap.fit.acceptance import LARGEST
from candata.gap.fit.problem import Problem
from candata.gap.run.pace import ANOTHER, ONE, REST, SHARPEN, SIGNATURE, Span
from candata.gap.screening.demand import wanted
from candata.gap.screening.look import unheld
from candata.gap.screening.signature_screen import screening
from candata.scenes.traits import is_toss

#: Signatures of all episodes that a first search came to need beside its first look: probes of a shortlist, and
#: variants on one element.
LATER = 80


def say_outlook(problem: Problem) -> None:
    """Tell that the search begins and what it takes, with signatures that are not kept yet, one cause and more."""
    each = problem.pace.range_of(ANOTHER)
    more = f"; each further cause {each} more" if each else ""
    lacking = _lacking(problem)
    if lacking:
        more += f"; {lacking} effects to simulate first"
    problem.pace.say("searching effects", first_cause(problem), more, after=further(problem, 1))


def further(problem: Problem, found: int) -> float:
    """Return how many replays are planned at most once so many causes are found: for others, and after the search.

    Of tosses each takes a look of its own at all effects, and one other is planned at a time.
    """
    others = max(LARGEST - found, 0)
    if is_toss(problem.replayer.scene):
        return min(others, 1) * (_looks(problem) + ANOTHER.most) + REST.most
    return others * ANOTHER.most + REST.most


def _looks(problem: Problem) -> float:
    """Return how many replays a look at all effects takes where each is simulated on every episode."""
    return float(sum(len(screening(c, problem)) for c in unheld(problem, ())))


def first_cause(problem: Problem) -> Span:
    """Return how many replays of all episodes the search for one cause takes, what is simulated first included."""
    if is_toss(problem.replayer.scene):
        looks = _looks(problem)
        return Span(ONE.least + looks, ONE.most + SHARPEN.most + looks)
    each = 1.0 if problem.library.seen else SIGNATURE
    asked = [part for part, some in wanted(problem, "first") if part.library.lacks(some)]
    looks = each * sum(len(part.recs) for part in asked) / len(problem.recs)
    later = each * LATER if asked else 0.0
    return Span(ONE.least + looks, ONE.most + looks + later)


def _lacking(problem: Problem) -> int:
    """Return how many of the signatures that are looked at first are not kept yet."""
    return sum(part.library.lacks(some) for part, some in wanted(problem, "first"))
