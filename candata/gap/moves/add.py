"""Add: one more effect, what is held moving along."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from candata.gap.moves.view import View
from candata.gap.search import Members

#: Proposals of a set, those that signatures promise most of first; of one effect at most two variants.
EACH, VARIANTS = 10, 2


def propose(view: View) -> Iterator[Members]:
    """Yield the set with each other effect, those that promise most first."""
    if not view.is_full:
        yield from islice(spread_over_names(view), EACH)


def spread_over_names(view: View) -> Iterator[Members]:
    """Yield sets with one more effect, of each effect few variants."""
    count: dict[str, int] = {}
    for one in view.beside(view.members):
        name = one.members[-1][0].name
        count[name] = count.get(name, 0) + 1
        if count[name] <= VARIANTS and (one.loss < view.now or one.members[-1][0].choices):
            yield one.members
