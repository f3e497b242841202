"""Add: one more effect, what is held moving along."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from candata.gap.fit.fits import Members
from candata.gap.moves._view import View

#: Proposals of a set, those that signatures promise most of first; of one effect at most two variants.
EACH, VARIANTS = 8, 2


def propose(view: View) -> Iterator[Members]:
    """Yield the set with each other effect, those that promise most first."""
    if view.has_room:
        yield from islice(_spread(view), EACH)


def _spread(view: View) -> Iterator[Members]:
    """Yield sets with one more effect, of each effect few variants."""
    count: dict[str, int] = {}
    for more in view.beside(view.members):
        name = more.members[-1][0].name
        count[name] = count.get(name, 0) + 1
        if count[name] <= VARIANTS and (more.loss < view.loss or more.members[-1][0].choices):
            yield more.members
