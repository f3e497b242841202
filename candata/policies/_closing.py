"""Ways in which the fingers of a hand close, and which fingertips then come towards each other."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from candata.policies import _drive as d
from candata.policies import _postures as p
from candata.policies._contract import Array
from candata.policies._grasp import Hand
from candata.scenes import Scene

#: Ways that are tried: the postures of the scene themselves, and random ones about them. Chosen: with more, the search
#: takes longer and finds no more.
WAYS, SEED = 32, 0
#: How far a random way begins from the open hand, as a share of each joint's range, and how much faster or slower each
#: joint closes. Chosen.
OPEN_SHARE, PACE = 0.25, (0.6, 1.4)
#: Shares of the way from open to closed at which the fingertips are looked at: smaller things need more than all.
SHARES = np.linspace(0.0, 2.0, 13)
#: Fingertips come towards each other when their gap shrinks by this much over the whole way [m]; neighbours do not.
SHRINK_M = 0.02


class Way(NamedTuple):
    """One way to close: commands `(A,)` of the open hand, and what is added to them until it is closed."""

    open: Array
    travel: Array


class Pinch(NamedTuple):
    """Two fingertips that are about to come nearer to each other.

    Attributes
    ----------
    way : Way
        How the fingers close.
    share : float
        How far they are closed.
    gap_m : float
        Distance of the fingertips.
    ends : (2, 3) float64 [m]
        The nearest points of the two, in the world, the hand being where the carrier starts.
    """

    way: Way
    share: float
    gap_m: float
    ends: Array

    @property
    def axis(self) -> Array:
        """Unit vector `(3,)` from the second fingertip to the first."""
        between = self.ends[0] - self.ends[1]
        return between / max(float(np.linalg.norm(between)), mujoco.mjMINVAL)


def ways(scene: Scene) -> list[Way]:
    """Return the ways to close: that of the scene's postures first, then random ones."""
    hand, rng = p.postures(scene), np.random.default_rng(SEED)
    low, high = d.useful_range(scene).T
    fingers = d.servos(scene) & ~np.isin(np.arange(len(low)), list(d.carriers(scene)))
    out = [Way(hand.open, np.where(fingers, hand.closed - hand.open, 0.0))]
    for _ in range(WAYS - 1):
        start = hand.open + rng.uniform(-OPEN_SHARE, OPEN_SHARE, len(low)) * (high - low)
        start = np.where(fingers, np.clip(start, low, high), hand.open)
        out.append(Way(start, out[0].travel * rng.uniform(*PACE, len(low))))
    return out


def pinches(scene: Scene, hand: Hand) -> list[Pinch]:
    """Return all pairs of fingertips that come towards each other, along each way and at each share of it."""
    low, high = d.useful_range(scene).T
    pairs = [(i, j) for i in range(len(hand.tips)) for j in range(i)]
    out = []
    for way in ways(scene):
        gaps, ends = np.zeros((len(SHARES), len(pairs))), np.zeros((len(SHARES), len(pairs), 2, 3))
        for k, share in enumerate(SHARES):
            hand.pose(np.clip(way.open + share * way.travel, low, high)[hand.free])
            for n, (i, j) in enumerate(pairs):
                gaps[k, n], ends[k, n] = hand.tip_gap(i, j)
        closing = np.diff(gaps, axis=0) < -SHRINK_M / (len(SHARES) - 1)
        out += [Pinch(way, float(SHARES[k]), float(gaps[k, n]), ends[k, n]) for k, n in np.argwhere(closing)]
    return out
