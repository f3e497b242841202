"""Place: the same effect on one element in place of all, on all in place of one, or on another one."""

from __future__ import annotations

from collections.abc import Iterator

from candata.gap.fit.candidates import candidate, local_candidates
from candata.gap.fit.fits import Members
from candata.gap.moves._view import View, free


def propose(view: View) -> Iterator[Members]:
    """Yield the set with a member's effect on other elements, beginning at the value that it has."""
    scene = view.problem.replayer.scene
    for c, u in free(view):
        whole = candidate(c.name, scene)
        for other in (whole, *local_candidates(whole, scene)):
            if other.label == c.label or other.choices:
                continue
            if other.size == c.size:
                at = u
            elif c.element is None and c.own[other.own].all() and other.size < c.size:
                at = u[other.own[c.own]]
            else:
                continue
            yield tuple((other, at) if m[0] is c else m for m in view.members)
