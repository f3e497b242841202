"""A look at every candidate, and whether the best of them passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import Candidate
from candata.gap.fit.comparison import (
    error_within,
    standard_error,
)
from candata.gap.fit.fits import Fit
from candata.gap.fit.response import Curve, Plane

Array = NDArray[np.float64]
#: Where the loss lies within the nulls' range: how many times its threshold and its standard error a gain must be, how
#: large the product of the two, and from how many times its threshold it counts when it removes most of the loss. A
#: gain that a few episodes of 20 make has few standard errors, whatever nulls gain. Record 43.
CLEAR, STEADY, PLAIN, MOST_OF_IT = 1.5, 2.5, 5.0, 3.0
#: How many times a gain's standard error within tasks counts where it is told by that. Chosen: of some 250 nulls one
#: gained 2.6 such errors sharply fitted, and none as much as this asks.
WITHIN = 1.5
#: Held-out gain [floors] below which an effect is not worth a name, significant or not.
MATTERS = 0.02


@dataclass(frozen=True)
class Stage:
    """One round of the search: every candidate on top of what is held.

    Attributes
    ----------
    base : (E,) float64
        Typical loss without another effect, in floors.
    luck : (J, E) float64
        How far the loss lies below it from each of the starts that are equally possible.
    fits : tuple of Fit
        Every lively candidate, best held-out gain first.
    threshold : float
        Held-out gain that null sets reach one time in a hundred.
    dead : tuple of str
        Candidates that this data cannot show.
    idle : tuple of str
        Candidates whose best value is their absence.
    faint : tuple of str
        Candidates that gained too little on a few episodes to be looked at further.
    reachable : float
        Mean loss that one true world in ten stays below, in floors; 0 where the floor is assumed and may be high.
    rough : sequence of (Candidate, Curve or Plane)
        Every lively candidate on a few episodes; where one alone leaves no gap, those that gain much on half of these.
        Empty where all were looked at on all of them.
    """

    base: Array
    luck: Array
    fits: tuple[Fit, ...]
    threshold: float
    dead: tuple[str, ...]
    idle: tuple[str, ...]
    faint: tuple[str, ...]
    reachable: float
    rough: Sequence[tuple[Candidate, Curve | Plane]] = ()

    @property
    def best_gain(self) -> float:
        """Held-out gain of the best candidate in floors; 0 where there is none."""
        return self.fits[0].gain if self.fits else 0.0

    def passing(self) -> Fit | None:
        """Return the best fit if it beats the nulls, one standard error of its own gain, and what matters at all.

        A loss below what a true world reaches is luck, and counts for nothing; so does the gain of one episode alone.
        """
        if not self.fits:
            return None
        best = self.fits[0]
        each = best.evidence.gain
        others = float(np.delete(each, np.argmax(each)).mean())
        sure = self._counted(best) > max(self.threshold, standard_error(each), MATTERS) and others > self.threshold / 2
        return best if sure else None

    def is_plain(self, best: Fit, tasks: Sequence[str]) -> bool:
        """Tell whether a gain is large enough to count although the loss itself lies within the nulls' range.

        Either it is sure, or it removes most of the loss, which no floor of the right height allows. Within `tasks` it
        may be so sure, and half as much again.
        """
        each, gain = best.evidence.gain, self._counted(best)
        error = min(standard_error(each), WITHIN * error_within(each, tasks))
        steady = gain > CLEAR * self.threshold and best.gain > STEADY * error
        sure = steady and gain**2 > PLAIN * self.threshold * error
        return sure or gain > max(MOST_OF_IT * self.threshold, float(self.base.mean()) / 2)

    def _counted(self, best: Fit) -> float:
        """Return how much of a fit's gain counts, in floors: down to the loss that true worlds reach."""
        return min(best.gain, float(self.base.mean()) - self.reachable)
