"""Forces and contact flags of an episode, side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._signal import quiet_noise, resolution
from candata.checks._view import EpisodeView
from candata.schema.contact import contact_of_totals

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Threshold that is assumed where the record states none [N]: the schema's default.
THRESHOLD_N = 0.3
#: A fingertip feels something from so many noises of its reading, or so many of its smallest steps. Chosen: of ten
#: thousand rows of a free fingertip none passes.
FEELS_NOISES, FEELS_STEPS = 6.0, 1.5


@dataclass(frozen=True, eq=False)
class FingertipForces:
    """Forces of an episode.

    Attributes
    ----------
    xyz : (T, F, 3) float64
        Forces [N], NaN where invalid.
    total : (T, F) float64
        |Fx| + |Fy| + |Fz| [N], what the threshold is compared with.
    threshold_n : float
        Threshold, stated or assumed [N].
    is_rule_stated : bool
        Whether the record states how flags came from forces.
    names : tuple of str
        Fingertips.
    release_n : float or None
        Force below which contact ends [N]; None where the threshold alone counts.
    before : (F,) bool, optional
        Flags before the first row: an episode may be cut out of a longer recording while a fingertip touches.
    """

    xyz: Array
    total: Array
    threshold_n: float
    is_rule_stated: bool
    names: tuple[str, ...]
    release_n: float | None = None
    before: Mask | None = None

    @property
    def touch(self) -> Mask:
        """`(T, F) bool`: in contact by the rule."""
        return contact_of_totals(self.total, self.threshold_n, self.release_n, self.before)

    @property
    def has_value(self) -> Mask:
        """`(T, F) bool`: where there is a value."""
        return np.isfinite(self.total)


def forces(view: EpisodeView) -> FingertipForces | None:
    """Return the forces of an episode; None where it has none."""
    xyz = view.values("fingertip_force")
    if xyz is None:
        return None
    rule = view.meta.contact_rule if view.meta else None
    threshold = rule.threshold_n if rule else THRESHOLD_N
    release_n = rule.release_n if rule else None
    names = view.elements("fingertip_force")
    total = np.abs(xyz).sum(axis=2)
    first_flags = flags(view, total.shape[1])
    before = None if first_flags is None else first_flags[0] > 0
    return FingertipForces(xyz, total, threshold, rule is not None, names, release_n, before)


def flags(view: EpisodeView, count: int) -> Array | None:
    """Return `(T, F) float64` contact flags of each fingertip, 0, 1 or NaN; None where there are none of F."""
    tip_flags = view.values("fingertip_contact")
    return tip_flags if tip_flags is not None and tip_flags.shape[1] == count else None


def any_contact(view: EpisodeView) -> Array | None:
    """Return `(T,) float64` whether any fingertip touches, by flags, 0, 1 or NaN; None where there are none."""
    tips = view.values("fingertip_contact")
    if tips is not None:
        return np.where(np.isfinite(tips).all(axis=1), np.nan_to_num(tips).max(axis=1), np.nan)
    return view.values("contact")


def feels_force(view: EpisodeView) -> Mask | None:
    """Return `(T,) bool` where any fingertip reads more than its noise, or nothing; None where there are no forces.

    A sensor that is not zero out of contact presses all the time: what it touches is not known.
    """
    force = forces(view)
    if force is None:
        return None
    thresholds = [
        [max(FEELS_NOISES * quiet_noise(axis), FEELS_STEPS * resolution(axis)) for axis in tip.T]
        for tip in np.moveaxis(force.xyz, 1, 0)
    ]
    return np.asarray(~(np.abs(force.xyz) <= np.array(thresholds)).all(axis=(1, 2)))
