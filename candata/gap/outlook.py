"""Outlook: what a search is going to take, said before it begins."""

from __future__ import annotations

from candata.gap.pace import ANOTHER, ONE, SIGNATURE, Span
from candata.gap.search import Problem
from candata.gap.wanted import wanted

#: Signatures of all episodes that a first search came to need beside its first look: probes of a shortlist, and
#: variants on one element.
LATER = 80


def say_outlook(problem: Problem) -> None:
    """Tell that the search begins and what it takes, with signatures that are not kept yet, one cause and more."""
    lacking = [part for part, some in wanted(problem, "first") if part.library.lacks(some)]
    each = 1.0 if problem.library.seen else SIGNATURE
    looks = each * sum(len(part.recs) for part in lacking) / len(problem.recs)
    further = problem.pace.range_of(ANOTHER)
    more = f"; each further cause {further} more" if further else ""
    if lacking:
        more += f"; {len(lacking)} effects to simulate first"
    later = each * LATER if lacking else 0.0
    problem.pace.say("searching effects", Span(ONE.least + looks, ONE.most + looks + later), more)
