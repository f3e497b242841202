"""Rule: forces are newtons: of the size that fingertips feel, and that the contact flags were made from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._forces import flags, forces
from candata.checks._signal import unit_of
from candata.checks._view import View, rounded

#: Median force in contact [N] of a set that is doubtful, and that no fingertip is made for. Sensors of robot
#: fingertips end at some tens of newtons (BioTac SP manual: 50 N; ATI Nano17 data sheet: 17 to 70 N); strong grippers
#: close with up to 235 N (Robotiq 2F-85 data sheet).
DOUBTFUL_N, IMPOSSIBLE_N = 60.0, 250.0
#: Factor between the threshold that flags imply and the stated one beyond which units differ.
FACTOR = 8.0
#: Share of readings that the implied threshold must get right, and readings of each kind that it takes.
RIGHT, FEWEST = 0.97, 5
#: Share of an episode's largest forces that is a firm touch: noise in another unit passes the threshold too.
FIRM = 0.2
REMEDY = "give the unit in the map (`units: {fingertip_force: gf}`), or divide the forces"


@dataclass(frozen=True)
class _Size:
    """What an episode tells: its id, the median force of firm touches [N], and the threshold its flags imply [N]."""

    id: str
    middle_n: float
    implied_n: float
    threshold_n: float


def _gather(view: View) -> _Size | None:
    """Return the sizes of an episode's forces; None where nothing is touched."""
    force = forces(view)
    if force is None:
        return None
    touching = force.touch & force.seen
    size = np.sqrt((force.xyz**2).sum(axis=2))
    if touching.sum() < FEWEST:
        return None
    flag = flags(view, force.total.shape[1])
    implied = np.nan
    if flag is not None:
        seen = force.seen & np.isfinite(flag)
        on, off = force.total[seen & (flag > 0)], force.total[seen & (flag == 0)]
        implied = _implied(on, off)
    firm = size[touching]
    firm = firm[firm > FIRM * np.quantile(firm, 0.99)]
    return _Size(view.id, float(np.median(firm)), implied, force.threshold_n)


def _implied(on: np.ndarray, off: np.ndarray) -> float:
    """Return the largest reading without a flag [N], at least: the threshold is no lower; NaN where none parts them."""
    if len(on) < FEWEST or len(off) < FEWEST:
        return np.nan
    least = float(np.quantile(on, 1 - RIGHT))
    below = off[off <= least]
    right = 0.5 * (RIGHT + len(below) / len(off))
    return float(below.max()) if len(below) and right > RIGHT - 0.02 else np.nan


def _judge(seen: Sequence[_Size]) -> Iterator[Finding]:
    """Yield episodes whose flags imply another unit, and a set whose forces no fingertip feels."""
    for one in seen:
        ratio = one.implied_n / one.threshold_n
        if ratio > FACTOR:
            unit = unit_of(ratio, 0.7)
            text = f"flags part at {one.implied_n:.3g}, stated {one.threshold_n:g} N: {ratio:.3g} times"
            text += f", as in {unit}" if unit else ""
            yield Finding(
                "error", "force_unit", f"forces are no newtons: {text}", one.id, "fingertip_force", None,
                "forces are no newtons", (),
                rounded({"ratio": ratio, "implied_threshold": one.implied_n, "as": unit or "no known unit"}), REMEDY,
            )  # fmt: skip
    middle = float(np.median([one.middle_n for one in seen]))
    if middle > DOUBTFUL_N:
        text = f"median {middle:.3g} N in contact, expected below {DOUBTFUL_N:g} N"
        yield Finding(
            "error" if middle > IMPOSSIBLE_N else "warning", "force_unit",
            f"forces are larger than fingertips feel: {text}", None, "fingertip_force", None,
            "forces are larger than fingertips feel", (),
            rounded({"median_N": middle, "in_gram_force_N": middle * 9.80665e-3, "episodes": len(seen)}), REMEDY,
        )  # fmt: skip


RULE = Rule(
    meaning="forces are newtons", gather=_gather, judge=_judge, needs=("fingertip_force",),
    idle="no fingertip touches anything",
)  # fmt: skip
