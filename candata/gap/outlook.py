"""Outlook: what a search is going to take, said before it begins."""

from __future__ import annotations

from candata.gap.pace import ANOTHER, MEAN, ONE, REST, SIGNATURE, Span
from candata.gap.screen import screening
from candata.gap.search import Problem
from candata.gap.stage import unheld
from candata.gap.starts import is_toss
from candata.gap.wanted import wanted
from candata.gap.worth import LARGEST

#: Signatures of all episodes that a first search came to need beside its first look: probes of a shortlist, and
#: variants on one element.
LATER = 80
#: Replays of all episodes that are planned after a first cause: all others that are searched for, or, where there is
#: no gap, a look at the mean over many replays, and what comes after the search.
FURTHER = max((LARGEST - 1) * ANOTHER.most, MEAN.most) + REST.most


def say_outlook(problem: Problem) -> None:
    """Tell that the search begins and what it takes, with signatures that are not kept yet, one cause and more."""
    further = problem.pace.range_of(ANOTHER)
    more = f"; each further cause {further} more" if further else ""
    lacking = _lacking(problem)
    if lacking:
        more += f"; {lacking} effects to simulate first"
    problem.pace.say("searching effects", first_cause(problem), more, after=FURTHER)


def first_cause(problem: Problem) -> Span:
    """Return how many replays of all episodes the search for one cause takes, what is simulated first included."""
    if is_toss(problem.replayer.scene):
        looks = float(sum(len(screening(c, problem)) for c in unheld(problem, ())))
        return Span(ONE.least + looks, ONE.most + looks)
    each = 1.0 if problem.library.seen else SIGNATURE
    asked = [part for part, some in wanted(problem, "first") if part.library.lacks(some)]
    looks = each * sum(len(part.recs) for part in asked) / len(problem.recs)
    later = each * LATER if asked else 0.0
    return Span(ONE.least + looks, ONE.most + looks + later)


def _lacking(problem: Problem) -> int:
    """Return how many of the signatures that are looked at first are not kept yet."""
    return sum(part.library.lacks(some) for part, some in wanted(problem, "first"))
