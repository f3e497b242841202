"""A fit: a set of candidates with their values, the response around them, and the held-out evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import Candidate
from candata.gap.fit.folds import CrossFit
from candata.gap.fit.response import Curve, Plane

Array = NDArray[np.float64]
Members = tuple[tuple[Candidate, Array], ...]


@dataclass(frozen=True)
class Fit:
    """A set of candidates, fitted.

    Attributes
    ----------
    members : tuple of (Candidate, coordinates)
        Fitted on all episodes.
    response : Curve or Plane
        Around the fit; a plane's coordinates are the members' in order.
    evidence : CrossFit
        Held-out losses and gains over the empty set.
    """

    members: Members
    response: Curve | Plane
    evidence: CrossFit

    @property
    def gain(self) -> float:
        """Mean held-out gain in floors."""
        return float(self.evidence.gain.mean())

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the members."""
        return tuple(c.label for c, _ in self.members)

    @property
    def curve(self) -> Curve:
        """The response of a scalar."""
        if not isinstance(self.response, Curve):
            raise TypeError(f"{self.labels} has no curve")
        return self.response

    @property
    def plane(self) -> Plane:
        """The response of a vector or of a set."""
        if not isinstance(self.response, Plane):
            raise TypeError(f"{self.labels} has no plane")
        return self.response

    @property
    def key(self) -> tuple[str, ...]:
        """What makes two sets the same: labels, and the value of each choice."""
        return key_of(self.members)

    def led_by(self, label: str) -> Fit:
        """Return the same set with one member before the others."""
        order = sorted(range(len(self.members)), key=lambda i: self.labels[i] != label)
        ends = np.cumsum([0, *(c.size for c, _ in self.members)])
        numbers = np.concatenate([np.arange(ends[i], ends[i + 1]) for i in order])
        plane, evidence = self.plane, self.evidence
        moved = replace(
            plane, low=plane.low[numbers], high=plane.high[numbers], at=plane.at[numbers], slope=plane.slope[numbers]
        )
        points = evidence.points[:, numbers]
        return Fit(tuple(self.members[i] for i in order), moved, replace(evidence, points=points))

    def split(self, u: Array) -> Members:
        """Return the members at stacked coordinates `u (d,)`."""
        out, start = [], 0
        for c, _ in self.members:
            out.append((c, u[start : start + c.size]))
            start += c.size
        return tuple(out)


def acting_members(members: Members) -> Members:
    """Return the members that are not at their neutral values."""
    return tuple((c, u) for c, u in members if not c.is_neutral(u))


def key_of(members: Members) -> tuple[str, ...]:
    """Return what makes two sets of effects the same: labels, and the value of each choice."""
    return tuple(sorted(f"{c.label}={u.tolist()}" if c.choices else c.label for c, u in members))
