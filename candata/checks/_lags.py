"""How many rows joints come behind their commands."""

from __future__ import annotations

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
#: Way of a command, in noises of its joint and in its unit, below which it tells nothing.
MOVES, LEAST = 10.0, 0.02
#: Averaging of speeds [s].
OVER_S = 0.03


def lag(view: View, rows: slice = slice(None), joint: Array | None = None) -> float:
    """Return by how many rows joints come behind their commands in some rows; NaN where they do not tell.

    The lag of most correlation between the speeds, all joints that move together, between rows by a parabola.
    `joint (T, J)` stands in for the recorded positions, if given.
    """
    joint, command = view.values("joint_position") if joint is None else joint, view.values("action")
    driven = pairs(view)
    if joint is None or command is None or not driven:
        return np.nan
    joint, command = joint[rows][:, [j for j, _ in driven]], command[rows][:, [a for _, a in driven]]
    total = len(joint)
    lags = np.arange(
        -min(round(AHEAD_S * view.rate_hz), total // 4), min(round(BEHIND_S * view.rate_hz), total // 3) + 1
    )
    if total < 30 or len(lags) < 5:
        return np.nan
    ways = [np.nan_to_num(np.nanmax(x, axis=0) - np.nanmin(x, axis=0)) for x in (joint, command)]
    moving = np.minimum(*ways) > np.maximum(LEAST, MOVES * noise(joint))
    if not moving.any():
        return np.nan
    width = max(3, round(OVER_S * view.rate_hz))
    first, second = (np.diff(smooth(x[:, moving], width), axis=0) for x in (command, joint))
    curves = correlation(first, second, lags)
    mean = np.median(curves, axis=1) if curves.shape[1] > 4 else np.mean(curves, axis=1)
    at = peak(mean)
    inside = 0 < at < len(lags) - 1
    return float(lags[0] + at) if inside and mean.max() > FOLLOWS else np.nan
