"""How many rows joints come behind their commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._drive import pairs
from candata.checks._signal import correlation, noise, peak, smooth
from candata.checks._view import View

Array = NDArray[np.float64]
#: Lags that are tried [s]: joints before their commands, and behind them.
AHEAD_S, BEHIND_S = 0.25, 0.6
#: Correlation of the speeds at the best lag below which nothing is said.
FOLLOWS = 0.5
#: Correlation of its speed with its command's from which a joint alone tells the time, and the share of its command's
#: way: what presses on something moves when that gives way. Measured on two fingers: free ones 0.95 to 0.99 and 0.8 to
#: 1.0, those that squeeze a can 0.4 to 0.9.
CLOSELY, FREELY = 0.9, 0.75
#: Way of a command, in noises of its joint and in its unit, below which it tells nothing.
MOVES, LEAST = 10.0, 0.02
#: Averaging of speeds [s].
OVER_S = 0.03


@dataclass(frozen=True)
class Followed:
    """How joints follow their commands in some rows, those that move and are commanded to.

    Attributes
    ----------
    names : tuple of str
    rows : float
        By how many rows they come behind, all together; NaN where they do not tell.
    by_joint : (M,) float64
        The same, joint by joint; NaN at the ends of the reach.
    alike : (M,) float64
        Largest correlation of its speed with its command's.
    share : (M,) float64
        Its way over its command's.
    """

    names: tuple[str, ...]
    rows: float
    by_joint: Array
    alike: Array
    share: Array


def lag(view: View, rows: slice = slice(None), joint: Array | None = None) -> float:
    """Return by how many rows joints come behind their commands in some rows; NaN where they do not tell."""
    lags = followed(view, rows, joint)
    return np.nan if lags is None else lags.rows


def followed(view: View, rows: slice = slice(None), joint: Array | None = None) -> Followed | None:
    """Return how joints follow their commands in some rows; None where none moves.

    The lag is that of most correlation between the speeds, between rows by a parabola. `joint (T, J)` stands in for the
    recorded positions, if given.
    """
    joint, command = view.values("joint_position") if joint is None else joint, view.values("action")
    driven = pairs(view)
    if joint is None or command is None or not driven:
        return None
    joint, command = joint[rows][:, [j for j, _ in driven]], command[rows][:, [a for _, a in driven]]
    total = len(joint)
    lags = np.arange(
        -min(round(AHEAD_S * view.rate_hz), total // 4), min(round(BEHIND_S * view.rate_hz), total // 3) + 1
    )
    if total < 30 or len(lags) < 5:
        return None
    ways = [np.nan_to_num(np.nanmax(x, axis=0) - np.nanmin(x, axis=0)) for x in (joint, command)]
    moving = np.minimum(*ways) > np.maximum(LEAST, MOVES * noise(joint))
    if not moving.any():
        return None
    width = max(3, round(OVER_S * view.rate_hz))
    first, second = (np.diff(smooth(x[:, moving], width), axis=0) for x in (command, joint))
    curves = correlation(first, second, lags)
    mean = np.median(curves, axis=1) if curves.shape[1] > 4 else np.mean(curves, axis=1)
    names = view.elements("joint_position")
    return Followed(
        tuple(names[j] for (j, _), moves in zip(driven, moving, strict=True) if moves),
        _inside(mean, lags) if mean.max() > FOLLOWS else np.nan,
        np.array([_inside(curve, lags) for curve in curves.T]),
        curves.max(axis=0),
        ways[0][moving] / ways[1][moving],
    )


def _inside(curve: Array, lags: NDArray[np.int64]) -> float:
    """Return the lag at which a curve is largest; NaN at the ends of the reach."""
    at = peak(curve)
    return float(lags[0] + at) if 0 < at < len(lags) - 1 else np.nan
