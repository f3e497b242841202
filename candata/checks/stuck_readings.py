"""Rule: no reading stands still for some rows of a motion and then catches up, as a sensor that was not read does."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._signal import noise
from candata.checks._view import EpisodeView

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Fewest equal rows, and times the usual number of rows between two new readings (a slow sensor repeats each). Chosen.
ROWS, USUAL = 4, 3.0
#: Rows before and after over which the speed is read.
SIDE_ROWS = 3
#: Way a row on both sides from which a reading cannot stand still by rounding: in usual steps between new readings, and
#: in steps of its counter. That step is told by so many values at which readings stand: fewer are no rounding.
MOVES, MOVES_COUNTS, FEWEST_VALUES = 1.0, 2.0, 10
#: Relative rounding of float32 values.
ROUNDING = 1e-6
#: The step that ends the standstill makes good the way at the speed before and after it, within this share: what sticks
#: and breaks away goes on with no such step. Each step beside it is at least this share of their mean.
WITHIN, STEADY = 0.5, 0.5
#: Share of equal neighbours, elsewhere in the episode, below which readings have noise that never repeats; there it is
#: enough that the step which ends the standstill is so many times the largest beside it, and so many times the noise.
#: Chosen: a motion that begins goes on.
RARE, TIMES, NOISES = 0.02, 3.0, 8.0
REMEDY = "the reading was repeated, not read: mark these rows invalid, and look at the bus or the tracker"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield joints and poses that stand still within a motion and catch up."""
    for name, (channel, values) in _series(view).items():
        rows = stuck_rows(values)
        if rows.any():
            yield view.finding(
                "warning",
                "stuck_readings",
                "a reading stands still while it moves, then catches up",
                f"{name} in {rows.sum()} rows",
                channel,
                rows,
                REMEDY,
                element=name,
                rows=int(rows.sum()),
            )


def _series(view: EpisodeView) -> dict[str, tuple[str, Array]]:
    """Return what is looked at: name to channel and `(T, D)` values."""
    out: dict[str, tuple[str, Array]] = {}
    joint = view.values("joint_position")
    if joint is not None:
        for column, name in enumerate(view.elements("joint_position")):
            out[f"joint {name}"] = ("joint_position", joint[:, column : column + 1])
    for channel in ("object_pose", "hand_pose"):
        pose = view.complete_values(channel)
        if pose is not None:
            out[channel] = (channel, pose[:, :3])
    return out


def stuck_rows(values: Array) -> Mask:
    """Return `(T,) bool`: rows of `(T, D)` in which a reading is repeated while what it reads goes on."""
    out = np.zeros(len(values), bool)
    step = np.diff(values, axis=0)
    size = np.linalg.norm(step, axis=1)  # NaN where a reading lacks: neither still nor a step
    new = np.flatnonzero(size > 0)
    if len(new) < 2 * SIDE_ROWS:
        return out
    usual_rows, equal_count = float(np.median(np.diff(new))), int((size == 0).sum())
    least_way = max(MOVES * float(np.median(size[new])), MOVES_COUNTS * _count(values[1:][size == 0]))
    least_step = NOISES * float(np.linalg.norm(noise(values)))
    for before, after in pairwise(new.tolist()):
        rows = after - before  # of equal readings: from before + 1 to after
        is_still = rows >= max(ROWS, USUAL * usual_rows) and (size[before + 1 : after] == 0).all()
        sides = _sides(step, before, after) if is_still else None
        if sides is None:
            continue
        is_rare = equal_count - (rows - 1) < RARE * len(size)
        if _makes_good(sides, step[after], rows, least_way) or (
            is_rare and _stands_out(sides, step[after], least_step)
        ):
            out[before + 2 : after + 1] = True
    return out


def _count(held_values: Array) -> float:
    """Return the step of a counter by the values `(N, D)` at which it stands, the smallest between two; else 0."""
    gaps = np.diff(np.sort(held_values, axis=0), axis=0)
    gaps = gaps[gaps > ROUNDING * np.abs(held_values).max(initial=0.0)]
    return float(gaps.min()) if len(gaps) >= FEWEST_VALUES else 0.0


def _sides(step: Array, before: int, after: int) -> Array | None:
    """Return `(2, SIDE_ROWS, D)` the steps beside a standstill; None at the ends, and where a reading lacks.

    The first of them end with the step `before`, the others begin after the step `after`.
    """
    sides = step[max(0, before + 1 - SIDE_ROWS) : before + 1], step[after + 1 : after + 1 + SIDE_ROWS]
    if any(len(side) < SIDE_ROWS or not np.isfinite(side).all() for side in sides):
        return None
    return np.stack(sides)


def _makes_good(sides: Array, last_step: Array, rows: int, least_way: float) -> bool:
    """Tell whether a step is the way of so many rows at the speed beside them, about the same on both sides."""
    speed = sides.mean(axis=(0, 1))
    way, size = rows * speed, float(np.linalg.norm(speed))
    is_steady = size > least_way and bool((sides @ speed > STEADY * size**2).all())
    return is_steady and bool(np.linalg.norm(last_step - way) < WITHIN * np.linalg.norm(way))


def _stands_out(sides: Array, last_step: Array, least_step: float) -> bool:
    """Tell whether a step is far larger than those beside it, and than noise."""
    return bool(np.linalg.norm(last_step) > max(TIMES * float(np.linalg.norm(sides, axis=2).max()), least_step))


RULE = Rule(meaning="no reading stands still within a motion", episode=_episode)
