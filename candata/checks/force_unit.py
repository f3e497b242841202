"""Rule: forces are newtons: of the size that fingertips feel, and that the contact flags were made from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._forces import flags, forces
from candata.checks._signal import unit_of
from candata.checks._view import EpisodeView, round_evidence

#: Median force in contact [N] of a set that is doubtful, and that no fingertip is made for. Sensors of robot
#: fingertips end at some tens of newtons (BioTac SP manual: 50 N; ATI Nano17 data sheet: 17 to 70 N); strong grippers
#: close with up to 235 N (Robotiq 2F-85 data sheet).
DOUBTFUL_N, IMPOSSIBLE_N = 60.0, 250.0
#: Factor between the threshold that flags imply and the stated one beyond which units differ.
FACTOR = 8.0
#: Share of readings that the implied threshold must get right, and readings of each kind that it takes.
RIGHT_SHARE, FEWEST = 0.97, 5
#: Share of an episode's largest forces that is a firm touch: noise in another unit passes the threshold too.
FIRM_SHARE = 0.2
REMEDY = "give the unit in the map (`units: {fingertip_force: gf}`), or divide the forces"


@dataclass(frozen=True)
class _Size:
    """Sizes of the forces of an episode: the median in firm touches [N], and the thresholds implied and stated [N]."""

    id: str
    middle_n: float
    implied_n: float
    threshold_n: float


def _gather(view: EpisodeView) -> _Size | None:
    """Return the sizes of an episode's forces; None where nothing is touched."""
    force = forces(view)
    if force is None:
        return None
    is_touching = force.touch & force.has_value
    size = np.sqrt((force.xyz**2).sum(axis=2))
    if is_touching.sum() < FEWEST:
        return None
    flag = flags(view, force.total.shape[1])
    implied_n = np.nan
    if flag is not None:
        has_both = force.has_value & np.isfinite(flag)
        forces_on, forces_off = force.total[has_both & (flag > 0)], force.total[has_both & (flag == 0)]
        implied_n = _implied_threshold(forces_on, forces_off)
    firm_forces = size[is_touching]
    firm_forces = firm_forces[firm_forces > FIRM_SHARE * np.quantile(firm_forces, 0.99)]
    return _Size(view.id, float(np.median(firm_forces)), implied_n, force.threshold_n)


def _implied_threshold(forces_on: np.ndarray, forces_off: np.ndarray) -> float:
    """Return the largest reading without a flag [N], at least: the threshold is no lower; NaN where none parts them."""
    if len(forces_on) < FEWEST or len(forces_off) < FEWEST:
        return np.nan
    least_on = float(np.quantile(forces_on, 1 - RIGHT_SHARE))
    below_on = forces_off[forces_off <= least_on]
    right_share = 0.5 * (RIGHT_SHARE + len(below_on) / len(forces_off))
    return float(below_on.max()) if len(below_on) and right_share > RIGHT_SHARE - 0.02 else np.nan


def _judge(episodes: Sequence[_Size]) -> Iterator[Finding]:
    """Yield episodes whose flags imply another unit, and a set whose forces no fingertip feels."""
    for episode in episodes:
        ratio = episode.implied_n / episode.threshold_n
        if ratio > FACTOR:
            unit = unit_of(ratio, 0.7)
            text = f"flags part at {episode.implied_n:.3g}, stated {episode.threshold_n:g} N: {ratio:.3g} times"
            text += f", as in {unit}" if unit else ""
            yield Finding(
                "error",
                "force_unit",
                f"forces are no newtons: {text}",
                episode=episode.id,
                channel="fingertip_force",
                problem="forces are no newtons",
                evidence=round_evidence(
                    {"ratio": ratio, "implied_threshold": episode.implied_n, "as": unit or "no known unit"}
                ),
                remedy=REMEDY,
            )
    median_n = float(np.median([episode.middle_n for episode in episodes]))
    if median_n > DOUBTFUL_N:
        text = f"median {median_n:.3g} N in contact, expected below {DOUBTFUL_N:g} N"
        yield Finding(
            "error" if median_n > IMPOSSIBLE_N else "warning",
            "force_unit",
            f"forces are larger than fingertips feel: {text}",
            channel="fingertip_force",
            problem="forces are larger than fingertips feel",
            evidence=round_evidence(
                {"median_N": median_n, "in_gram_force_N": median_n * 9.80665e-3, "episodes": len(episodes)}
            ),
            remedy=REMEDY,
        )


RULE = Rule(
    meaning="forces are newtons",
    gather=_gather,
    judge=_judge,
    needs=("fingertip_force",),
    idle_reason="no fingertip touches anything",
)
