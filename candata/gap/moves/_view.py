"""What a move sees: a set that was visited, on the few episodes on which proposals are compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.acceptance import is_full
from candata.gap.fit.candidates import Candidate
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Plane
from candata.gap.measure.score import Compact
from candata.gap.screening.elements import promising
from candata.gap.screening.look import unheld
from candata.gap.screening.signature_screen import respond, slope_of
from candata.gap.screening.sums import WITHIN, Responses, Sum, beside

Index = NDArray[np.int64]


@dataclass(frozen=True)
class View:
    """A visited set and what effects promise beside it.

    Attributes
    ----------
    root : Problem
        All episodes in units of the nominal world's floor.
    problem : Problem
        All episodes in the units of the fit.
    part : Problem
        A few of them.
    index : (e,) int64
        Which.
    fit : Fit
        The set.
    alone : Responses
        Every effect alone on the few episodes, in the units of `root`.
    remains : bool
        Whether the incumbent leaves more than nulls do.
    """

    root: Problem
    problem: Problem
    part: Problem
    index: Index
    fit: Fit
    alone: Responses
    remains: bool

    @property
    def members(self) -> Members:
        """The effects of the set with their values."""
        return self.fit.members

    @property
    def has_room(self) -> bool:
        """Whether another effect may come to the set."""
        return self.remains and not is_full(self.members, self.problem.measured)

    @cached_property
    def residuals(self) -> Compact:
        """Residuals `(e, K)` of the few episodes with the set."""
        return self.problem.where(self.fit)[self.index]

    @cached_property
    def pieces(self) -> Responses:
        """How the residuals change with each member around where it is."""
        if isinstance(self.fit.response, Plane):
            slope = self.fit.response.slope
        else:
            ((c, u),) = self.fit.members
            slope = slope_of(c, self.fit.response, u, WITHIN)
        ends = np.cumsum([c.size for c, _ in self.members])[:-1]
        parts = np.split(slope[:, self.index], ends)
        return [
            (c, Plane(c.low, c.high, u, self.residuals, each)) for (c, u), each in zip(self.members, parts, strict=True)
        ]

    @cached_property
    def loss(self) -> float:
        """Loss [floors] of the set on the few episodes."""
        return float(self.part.score.loss(self.residuals).mean())

    def beside(self, held: Members) -> list[Sum]:
        """Return some members of the set with each other effect, by what signatures promise, the best first."""
        kept = [piece for piece in self.pieces if any(piece[0] is c for c, _ in held)]
        here = self.residuals if len(held) == len(self.members) else self.part.at(held)
        others = self._responses(here, held)
        kept = [(c, Plane(r.low, r.high, r.at, here, r.slope)) for c, r in kept]  # type: ignore[union-attr]
        return beside(self.part, here, kept, others)

    def _responses(self, here: Compact, held: Members) -> Responses:
        """Return the responses of all effects, and of promising variants on one element, on top of some members."""
        acting = {c.label for c, _ in held}
        whole = len(held) == len(self.members)
        some = [c for c in unheld(self.part, held) if whole or not c.choices]
        found, _ = respond(self.part, here, some, held)
        if not whole:
            return found
        base = self.part.score.loss(here)
        variants = [v for v in promising(self.part, here, found, base) if v.label not in acting]
        return [*found, *respond(self.part, here, variants, held)[0]]


def free(view: View) -> list[tuple[Candidate, NDArray[np.float64]]]:
    """Return the members that were searched for; one that was measured without a fit stays."""
    known = {c.name for c, _ in view.problem.measured}
    return [m for m in view.members if m[0].name not in known]
