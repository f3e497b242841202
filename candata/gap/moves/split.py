"""Split: a member and an effect that does much the same share what it explains.

Where both act, the one that was taken made up for the other, which gains nothing beside it: no slope leads from there.
"""

from __future__ import annotations

from collections.abc import Iterator

from candata.gap.fit.fits import Members
from candata.gap.moves._view import View, free
from candata.gap.screening.episodes import brief
from candata.gap.screening.shortlist import fitted

#: Effects that are tried beside each member: those that explain most alone. Shares of what the member is, and of what
#: the effect is alone, at which both begin. Chosen.
EACH, SHARES = 3, ((0.3, 0.7), (0.6, 0.4), (0.8, 0.4))


def propose(view: View) -> Iterator[Members]:
    """Yield the set with a member at a share of what it is and another effect at the rest of what that is alone."""
    if not view.has_room:
        return
    others = _strongest(view)
    for member in free(view):
        c, u = member
        if c.choices:
            continue
        for other, at in others:
            for own, rest in SHARES:
                part = (c, c.neutral + own * (u - c.neutral))
                kept = tuple(part if m is member else m for m in view.members)
                yield (*kept, (other, other.neutral + rest * (at - other.neutral)))


def _strongest(view: View) -> Members:
    """Return the effects, at their best values, that explain most of the few episodes alone and are not in the set."""
    part, _ = brief(view.root)
    base, taken = part.score.loss(part.nominal), {c.name for c, _ in view.members}
    best: dict[str, tuple[float, Members]] = {}
    for c, response in view.alone:
        if c.name in taken or c.choices:
            continue
        gain, at = fitted(part, response, base)
        if gain > best.get(c.name, (0.0, ()))[0]:
            best[c.name] = gain, ((c, at),)
    order = sorted(best.values(), key=lambda pair: -pair[0])
    return tuple(m for _, (m,) in order[:EACH])
