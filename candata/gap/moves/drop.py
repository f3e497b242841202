"""Drop: the set without a member for which the others may make up."""

from __future__ import annotations

from collections.abc import Iterator

from candata.gap.fit.fits import Members
from candata.gap.moves._view import View, free


def propose(view: View) -> Iterator[Members]:
    """Yield the set without each member."""
    if len(view.members) > 1:
        for left in free(view):
            yield tuple(m for m in view.members if m is not left)
