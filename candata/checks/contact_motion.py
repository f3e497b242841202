"""Rule: without forces beside them, contact flags are on where the object is moved.

An object that nobody touches rests or falls. Where flags are off whenever it moves otherwise, and on while it rests,
they may say the opposite. Only where there are no forces to compare with: those tell more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._forces import touched
from candata.checks._signal import noise, smooth
from candata.checks._view import View, rounded
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

    moving_on: int
    on: int
    moving_off: int
    off: int


def _gather(view: View) -> _Counts | None:
    """Return the counts of an episode; None where there are forces, or no flags."""
    touch, pose = touched(view), view.whole("object_pose")
    if touch is None or pose is None or "fingertip_force" in view.raw.arrays:
        return None
    width = max(3, round(OVER_S * view.rate_hz))
    place = smooth(pose[:, :3], width)
    velocity = np.gradient(place, 1 / view.rate_hz, axis=0)
    quiet = float(np.linalg.norm(noise(pose[:, :3]))) * view.rate_hz / np.sqrt(width) / width
    falling = np.gradient(velocity[:, 2], 1 / view.rate_hz) < -FALLS * GRAVITY_MPS2
    speed = np.linalg.norm(velocity, axis=1)
    seen = np.isfinite(speed) & np.isfinite(touch) & ~falling
    moving = seen & (speed > max(MOVES_MPS, NOISES * quiet))
    on, off = seen & (touch > 0), seen & (touch == 0)
    return _Counts(int((moving & on).sum()), int(on.sum()), int((moving & off).sum()), int(off.sum()))


def _judge(seen: Sequence[_Counts]) -> Iterator[Finding]:
    """Yield that the object moves when nobody touches it, and rests when somebody does."""
    moving_on, on, moving_off, off = (
        sum(getattr(c, k) for c in seen) for k in ("moving_on", "on", "moving_off", "off")
    )
    if moving_on + moving_off < FEWEST or min(on, off) < FEWEST:
        reason = "the object hardly moves, or contact hardly changes"
        yield Finding("unknown", "contact_motion", reason, problem=reason)
        return
    shares = moving_on / on, moving_off / off
    if shares[1] > TIMES * shares[0]:
        problem = "the object moves when no contact is flagged, and rests when it is: flags may be inverted"
        yield Finding(
            "warning", "contact_motion", f"{problem}: it moves in {shares[1]:.0%} of the rows without contact, in "
            f"{shares[0]:.0%} of those with it", None, "contact", None, problem, (),
            rounded({"moving_without": shares[1], "moving_with": shares[0]}), "look at some episodes; invert the flags",
        )  # fmt: skip


RULE = Rule(
    meaning="contact is flagged where objects are moved", gather=_gather, judge=_judge, needs=("object_pose",),
)  # fmt: skip
