"""Exchange: another effect in the place of a member, which was chosen while others were missing."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from candata.gap.fit.fits import Members
from candata.gap.moves._view import View, free

#: Proposals in the place of each member.
EACH = 3


def propose(view: View) -> Iterator[Members]:
    """Yield the set with each member exchanged for what promises most in its place."""
    if len(view.members) < 2:
        return
    for member in free(view):
        kept = tuple(m for m in view.members if m is not member)
        others = (more.members for more in view.beside(kept) if more.members[-1][0].name != member[0].name)
        yield from islice(others, EACH)
