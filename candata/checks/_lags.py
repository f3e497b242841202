"""Lags: rows by which joints come behind their commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._drive import pairs
from candata.checks._signal import correlation, moving_mean, noise, peak
from candata.checks._view import EpisodeView

Array = NDArray[np.float64]
#: Lags that are tried [s]: joints before their commands, and behind them.
AHEAD_S, BEHIND_S = 0.25, 0.6
#: Correlation of the speeds at the best lag below which nothing is said.
FOLLOWS = 0.5
#: Least correlation of the speeds of a joint and its command, and least share of the command's way, for a joint to be
#: timed alone: what presses on something moves when that gives way.
#: Measured on two fingers: free ones 0.95 to 0.99 and 0.8 to 1.0, those that squeeze a can 0.4 to 0.9.
CLOSELY, FREELY = 0.9, 0.75
#: Way of a command, in noises of its joint and in its unit, below which it tells nothing.
MOVES, LEAST_WAY = 10.0, 0.02
#: Averaging of speeds [s].
OVER_S = 0.03


@dataclass(frozen=True)
class JointLags:
    """Lags of the joints that move and are commanded to, in some rows of an episode.

    Attributes
    ----------
    names : tuple of str
    rows : float
        By how many rows they come behind, all together; NaN where they do not tell.
    by_joint : (M,) float64
        The same, joint by joint; NaN at the ends of the reach.
    correlations : (M,) float64
        Largest correlation of its speed with its command's.
    share : (M,) float64
        Its way over its command's.
    """

    names: tuple[str, ...]
    rows: float
    by_joint: Array
    correlations: Array
    share: Array


def lag(view: EpisodeView, rows: slice = slice(None), joint: Array | None = None) -> float:
    """Return by how many rows joints come behind their commands in some rows; NaN where they do not tell."""
    lags = joint_lags(view, rows, joint)
    return np.nan if lags is None else lags.rows


def joint_lags(view: EpisodeView, rows: slice = slice(None), joint: Array | None = None) -> JointLags | None:
    """Return how joints follow their commands in some rows; None where none moves.

    The lag is that of most correlation between the speeds, between rows by a parabola. `joint (T, J)` stands in for the
    recorded positions, if given.
    """
    joint, command = view.values("joint_position") if joint is None else joint, view.values("action")
    column_pairs = pairs(view)
    if joint is None or command is None or not column_pairs:
        return None
    joint, command = joint[rows][:, [j for j, _ in column_pairs]], command[rows][:, [a for _, a in column_pairs]]
    total = len(joint)
    lags = np.arange(
        -min(round(AHEAD_S * view.rate_hz), total // 4), min(round(BEHIND_S * view.rate_hz), total // 3) + 1
    )
    if total < 30 or len(lags) < 5:
        return None
    ways = [np.nan_to_num(np.nanmax(x, axis=0) - np.nanmin(x, axis=0)) for x in (joint, command)]
    is_moving = np.minimum(*ways) > np.maximum(LEAST_WAY, MOVES * noise(joint))
    if not is_moving.any():
        return None
    width = max(3, round(OVER_S * view.rate_hz))
    command_steps, joint_steps = (np.diff(moving_mean(x[:, is_moving], width), axis=0) for x in (command, joint))
    curves = correlation(command_steps, joint_steps, lags)
    mean = np.median(curves, axis=1) if curves.shape[1] > 4 else np.mean(curves, axis=1)
    names = view.elements("joint_position")
    return JointLags(
        tuple(names[j] for (j, _), moves in zip(column_pairs, is_moving, strict=True) if moves),
        _inner_peak(mean, lags) if mean.max() > FOLLOWS else np.nan,
        np.array([_inner_peak(curve, lags) for curve in curves.T]),
        curves.max(axis=0),
        ways[0][is_moving] / ways[1][is_moving],
    )


def _inner_peak(curve: Array, lags: NDArray[np.int64]) -> float:
    """Return the lag at which a curve is largest; NaN at the ends of the reach."""
    at = peak(curve)
    return float(lags[0] + at) if 0 < at < len(lags) - 1 else np.nan
