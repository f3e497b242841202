"""What a forecast of a command chunk costs: how far the object stays from its goal, and whether it is held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.errors import UsageError
from candata.policies import Goal
from candata.rotation import conjugate, multiply, rotate
from candata.simulate.outcome import TOPPLED_RAD

Array = NDArray[np.float64]
#: Largest deficit of one part of a goal. Chosen: twice the goal; an object that falls off the table counts no worse.
MOST_DEFICIT = 2.0
#: Weight of what a chunk does beyond its goal, and how far beyond counts, as a share of the goal. Chosen: of two chunks
#: that reach the goal the one with the larger margin is taken, and no margin outweighs a goal that is missed.
SURPLUS_WEIGHT, MOST_SURPLUS = 0.1, 1.0
#: Weight of contact that is lost, where the goal needs the hand. Chosen: half a goal.
CONTACT_WEIGHT = 0.5
#: Share of the chunk at its end over which the hand must touch. Chosen: fingers that close have done so by then.
HELD_SHARE = 0.5


@dataclass(frozen=True)
class ChunkCost:
    """What forecasts of chunks cost.

    Attributes
    ----------
    cost : (...) float64
        Deficit of the goal in goals, less a little for what is done beyond it, plus contact that is lost.
    reached : (...) bool
        Whether the forecast reaches the goal.
    """

    cost: Array
    reached: NDArray[np.bool_]


def chunk_cost(goal: Goal, poses: Array, contact: Array | None, rate_hz: float) -> ChunkCost:
    """Return what forecasts cost.

    Parameters
    ----------
    goal : Goal
        What is meant, from the present row on.
    poses : (..., T + 1, 7) float64
        Poses of the object [m, quaternion w x y z], the present one first.
    contact : (..., T) float64 or None
        Probability of contact after each step; None where nothing forecasts it.
    rate_hz : float
        Rows a second.

    Raises
    ------
    UsageError
        When the goal asks for nothing that poses can tell.
    """
    deficits = _deficits(goal, poses, rate_hz)
    reached = np.all([deficit <= 0 for deficit in deficits], axis=0)
    parts = [np.where(d > 0, d.clip(max=MOST_DEFICIT), SURPLUS_WEIGHT * d.clip(-MOST_SURPLUS)) for d in deficits]
    cost = np.sum(parts, axis=0)
    if contact is not None and (goal.lift_m > 0 or goal.turn_rad > 0):
        held_rows = max(1, round(HELD_SHARE * contact.shape[-1]))
        cost = cost + CONTACT_WEIGHT * (1 - contact[..., -held_rows:].mean(-1))
    return ChunkCost(cost, reached)


def _deficits(goal: Goal, poses: Array, rate_hz: float) -> list[Array]:
    """Return what is missing of each part of a goal `(...)`, in goals; below 0 where more than that is done."""
    deficits = []
    if goal.lift_m > 0:
        rise = poses[..., 1:, 2] - poses[..., :1, 2]
        rows = min(max(1, round(goal.held_s * rate_hz)), rise.shape[-1])
        held = np.lib.stride_tricks.sliding_window_view(rise, rows, axis=-1).min(-1)
        deficits.append(1 - held.max(-1) / goal.lift_m)
    if goal.place_m is not None:
        way = poses[..., -1, :2] - poses[..., 0, :2] - np.asarray(goal.place_m)[:2]
        deficits.append(np.linalg.norm(way, axis=-1) / goal.place_tolerance_m - 1)
    if goal.turn_rad > 0:
        relative = multiply(poses[..., 3:], conjugate(poses[..., :1, 3:]))
        turn = 2 * np.arctan2(np.abs(relative[..., 3]), np.abs(relative[..., 0]))
        deficits.append(1 - turn.max(-1) / goal.turn_rad)
    if goal.topple:
        upward = np.broadcast_to([0.0, 0.0, 1.0], (*poses.shape[:-2], 3))
        first, last = (rotate(conjugate(poses[..., row, 3:]), upward) for row in (0, -1))
        deficits.append(1 - np.arccos(np.clip((first * last).sum(-1), -1, 1)) / TOPPLED_RAD)
    if not deficits or goal.slip:
        raise UsageError("the goal has no cost", expected="a lift, a place, a turn or a topple")
    return deficits
