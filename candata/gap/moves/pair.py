"""Pair: two or three effects to whose signatures the recording adds up.

Growth takes first what makes up best for all causes at once; this begins with all of them.
"""

from __future__ import annotations

from collections.abc import Iterator

from candata.gap.fit.fits import Members
from candata.gap.moves._view import View
from candata.gap.screening.episodes import brief
from candata.gap.screening.sums import sums

#: Sets of each size, those that leave least first.
EACH = 4


def propose(view: View) -> Iterator[Members]:
    """Yield pairs and triples of effects, where the set holds one effect so far."""
    if len(view.members) == 1 and view.remains:
        for size in sums(brief(view.root)[0], view.alone):
            for added in size[:EACH]:
                yield added.members
