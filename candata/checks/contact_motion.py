"""Rule: without forces beside them, contact flags are on where the object is moved.

An object that nobody touches rests or falls. Flags that are off whenever it moves otherwise, and on while it rests, may
be inverted. The rule looks only at episodes without forces: those tell more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._forces import any_contact
from candata.checks._signal import moving_mean, noise
from candata.checks._view import EpisodeView, round_evidence
from candata.checks.free_fall import GRAVITY_MPS2

#: Speed [m/s] from which an object moves, and in noises of the averaged speed; averaging [s].
MOVES_MPS, NOISES, OVER_S = 0.02, 6.0, 0.1
#: Downward acceleration, as a share of gravity, from which it may be falling.
FALLS = 0.5
#: Fewest rows moving and with each flag; how many times as often it moves without contact as with it.
FEWEST, TIMES = 50, 5.0


@dataclass(frozen=True)
class _Counts:
    """Rows of an episode: moving and all, with contact and without."""

    moving_touched: int
    touched_rows: int
    moving_free: int
    free_rows: int


def _gather(view: EpisodeView) -> _Counts | None:
    """Return the counts of an episode; None where there are forces, or no flags."""
    touch, pose = any_contact(view), view.complete_values("object_pose")
    if touch is None or pose is None or "fingertip_force" in view.raw.arrays:
        return None
    width = max(3, round(OVER_S * view.rate_hz))
    place = moving_mean(pose[:, :3], width)
    velocity = np.gradient(place, 1 / view.rate_hz, axis=0)
    speed_noise = float(np.linalg.norm(noise(pose[:, :3]))) * view.rate_hz / np.sqrt(width) / width
    is_falling = np.gradient(velocity[:, 2], 1 / view.rate_hz) < -FALLS * GRAVITY_MPS2
    speed = np.linalg.norm(velocity, axis=1)
    is_known = np.isfinite(speed) & np.isfinite(touch) & ~is_falling
    is_moving = is_known & (speed > max(MOVES_MPS, NOISES * speed_noise))
    is_touched, is_untouched = is_known & (touch > 0), is_known & (touch == 0)
    return _Counts(
        int((is_moving & is_touched).sum()),
        int(is_touched.sum()),
        int((is_moving & is_untouched).sum()),
        int(is_untouched.sum()),
    )


def _judge(episodes: Sequence[_Counts]) -> Iterator[Finding]:
    """Yield that the object moves when nobody touches it, and rests when somebody does."""
    moving_touched, touched_rows, moving_free, free_rows = (
        sum(getattr(c, k) for c in episodes) for k in ("moving_touched", "touched_rows", "moving_free", "free_rows")
    )
    if moving_touched + moving_free < FEWEST or min(touched_rows, free_rows) < FEWEST:
        reason = "the object hardly moves, or contact hardly changes"
        yield Finding("unknown", "contact_motion", reason, problem=reason)
        return
    shares = moving_touched / touched_rows, moving_free / free_rows
    if shares[1] > TIMES * shares[0]:
        problem = "the object moves when no contact is flagged, and rests when it is: flags may be inverted"
        yield Finding(
            "warning",
            "contact_motion",
            f"{problem}: it moves in {shares[1]:.0%} of the rows without contact, in {shares[0]:.0%} of those with it",
            channel="contact",
            problem=problem,
            evidence=round_evidence({"moving_without": shares[1], "moving_with": shares[0]}),
            remedy="look at some episodes; invert the flags",
        )


RULE = Rule(
    meaning="contact is flagged where objects are moved",
    gather=_gather,
    judge=_judge,
    needs=("object_pose",),
)
