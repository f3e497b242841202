"""Pair: two effects to whose signatures the recording adds up; growth takes first what makes up best for both."""

from __future__ import annotations

from collections.abc import Iterator

from candata.gap.moves.view import View
from candata.gap.search import Members
from candata.gap.together import sums

#: Pairs, and triples, those that leave least first.
EACH = 6


def propose(view: View) -> Iterator[Members]:
    """Yield pairs and triples of effects, where the set holds one effect so far."""
    if len(view.members) == 1:
        for some in sums(view.part, view.alone):
            for one in some[:EACH]:
                yield one.members
