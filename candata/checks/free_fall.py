"""Rule: what flies freely falls freely: with 9.81 m/s2, along -z.

An object flies while nobody touches it (by its flags, or because the episode has no commands at all) and its place is a
parabola to within noise over a whole window of rows, with at least a quarter of gravity. Hovering and sliding are none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.checks._forces import touched
from candata.checks._signal import noise
from candata.checks._view import View, rounded

Array = NDArray[np.float64]
#: Standard gravity [m/s^2] (CGPM 1901).
GRAVITY_MPS2 = 9.80665
#: Windows: fewest rows, shortest time [s], growth from one length to the next.
ROWS, SHORTEST_S, GROWTH = 8, 0.05, 1.3
#: A fall is one from here on [m].
FALLEN_M = 0.01
#: Smallest acceleration that is a flight, as a share of gravity.
LEAST = 0.25
#: A window is a parabola when its residual is within so many times the noise, or this [m].
WITHIN, WITHIN_M = 1.5, 2e-5
#: Largest standard error of one flight, as a share.
ERROR = 0.1
#: Flights that agree: within this share of their median, and so many standard errors; the share of them that must.
AGREE, ERRORS, MOST = 0.06, 3.0, 0.7
#: Differences from gravity that are told, doubtful and wrong, as shares.
TOLD, DOUBTFUL, WRONG = 0.015, 0.05, 0.2
#: Standard errors by which the median of all flights must be off.
SURE = 4.0
#: Fewest flights for a finding; an episode that differs from the others by this share, among this share that agree.
FEWEST, APART, NEARLY_ALL = 3, 0.12, 0.85
#: Angle to -z from which things do not fall down.
TILT_DEG = 10.0
REMEDY = "check the unit and scale of the poses, the rate, and whether z points up"


@dataclass(frozen=True)
class _Flight:
    """The surest flight of an episode: acceleration [m/s^2], its standard error, from when to when [s]."""

    id: str
    acceleration: Array
    error: float
    span: tuple[float, float]


def _gather(view: View) -> _Flight | None:
    """Return the longest flight of an episode; None where nothing flies."""
    pose, touch = view.whole("object_pose"), touched(view)
    if pose is None or view.time_s is None or (touch is None and "action" in view.raw.arrays):
        return None
    free = np.isfinite(pose[:, 0]) & (np.ones(len(pose), bool) if touch is None else touch == 0)
    place, step = np.nan_to_num(pose[:, :3]), 1 / view.rate_hz
    free &= _before_impact(place[:, 2], free)
    quiet = float(np.median(noise(pose[:, :3])))
    even = np.abs(np.diff(view.time_s, prepend=-step) - step) < 0.2 * step
    best: list[_Flight] = []
    rows = max(ROWS, int(np.ceil(SHORTEST_S / step)))
    while rows <= len(place):
        found = _longest(view, place, free & even, rows, step, quiet)
        if found is None:
            break
        best.append(found)
        rows = int(np.ceil(GROWTH * rows))
    # The longest window may reach into an impact; the one before it does not, or less.
    return best[max(0, len(best) - 2)] if best and best[max(0, len(best) - 2)].error < ERROR else None


def _before_impact(height: Array, free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return `(T,) bool`: rows of each free stretch until a fall first ends; what bounces may slide as well."""
    keep = np.zeros(len(height), bool)
    for start, end in np.flatnonzero(np.diff(np.r_[False, free, False].astype(np.int8))).reshape(-1, 2):
        z = height[start:end]
        fallen = np.maximum.accumulate(z) - z
        risen = z - np.minimum.accumulate(np.where(fallen > FALLEN_M, z, np.inf))
        stop = np.flatnonzero((risen > 0.2 * FALLEN_M) | (_slow(z) & (fallen > FALLEN_M)))
        keep[start : start + int(stop[0]) if len(stop) else end] = True
    return keep


def _slow(z: Array) -> NDArray[np.bool_]:
    """Return rows after which the height hardly changes any more, against its fastest row so far."""
    step = np.abs(np.diff(z, append=z[-1:]))
    return np.asarray(step < 0.3 * np.maximum.accumulate(step))


def _longest(view: View, place: Array, free: NDArray[np.bool_], rows: int, step: float, quiet: float) -> _Flight | None:
    """Return the flight in the window of so many rows that is the best parabola; None where none is."""
    x = np.linspace(-1, 1, rows)
    basis, _ = np.linalg.qr(np.stack([np.ones(rows), x, x**2], axis=1))
    windows = np.lib.stride_tricks.sliding_window_view(place, rows, axis=0)
    parts = windows @ basis
    left = np.maximum((windows - windows.mean(-1, keepdims=True)) ** 2, 0).sum(-1) - (parts[..., 1:] ** 2).sum(-1)
    residual = np.sqrt(np.maximum(left, 0) / (rows - 3)).max(axis=1)
    # x**2 in steps: its second derivative in time is 2 / (half the window)^2.
    curve = 2 / (0.5 * (rows - 1) * step) ** 2 / float(basis[:, 2] @ x**2)
    # (signed: the basis may point either way)
    acceleration = parts[..., 2] * curve
    whole = np.convolve(free, np.ones(rows), "valid") > rows - 0.5
    size = np.linalg.norm(acceleration, axis=1)
    good = whole & (size > LEAST * GRAVITY_MPS2) & (residual < max(WITHIN * quiet, WITHIN_M))
    if not good.any():
        return None
    k = int(np.argmin(np.where(good, residual, np.inf)))
    error = max(quiet, float(residual[k])) * abs(curve) / size[k]
    times = np.zeros(0) if view.time_s is None else view.time_s
    return _Flight(view.id, acceleration[k], float(error), (float(times[k]), float(times[k + rows - 1])))


def _judge(seen: Sequence[_Flight]) -> Iterator[Finding]:
    """Yield what all flights say of gravity, and flights that differ from all others."""
    size = np.array([np.linalg.norm(one.acceleration) for one in seen])
    errors = np.array([one.error for one in seen])
    middle = float(np.median(size))
    agree = np.abs(size / middle - 1) < AGREE + ERRORS * errors
    if len(seen) < FEWEST or agree.mean() < MOST:
        reason = "too few flights" if len(seen) < FEWEST else "flights do not agree on any acceleration"
        yield Finding("unknown", "free_fall", reason, problem=reason)
        return
    yield from _gravity(seen, size, agree)
    if agree.mean() >= NEARLY_ALL:
        apart = ~agree & (np.abs(size / middle - 1) > np.maximum(APART, 6 * errors))
        # An origin off the mass centre goes round it: that pulls to all sides, a wrong scale of height only down.
        down = np.array([-one.acceleration[2] for one in seen]) > np.cos(np.radians(TILT_DEG)) * size
        for k in np.flatnonzero(apart & down).tolist():
            problem = "a flight is not as the others"
            yield Finding(
                "warning", "free_fall", f"{problem}: {size[k]:.3g} m/s2 where the others have {middle:.3g}", seen[k].id,
                "object_pose", None, problem, (seen[k].span,),
                rounded({"acceleration_mps2": size[k], "others_mps2": middle}), REMEDY,
            )  # fmt: skip


def _gravity(seen: Sequence[_Flight], size: Array, agree: NDArray[np.bool_]) -> Iterator[Finding]:
    """Yield that things fall with another acceleration than gravity, or in another direction."""
    some = size[agree]
    middle = float(np.median(some))
    error = float(1.2533 * 1.4826 * np.median(np.abs(some - middle)) / np.sqrt(len(some)))
    off = abs(middle / GRAVITY_MPS2 - 1)
    mean = np.median([seen[k].acceleration / size[k] for k in np.flatnonzero(agree).tolist()], axis=0)
    tilt = float(np.degrees(np.arccos(np.clip(-mean[2] / np.linalg.norm(mean), -1, 1))))
    evidence = rounded({"acceleration_mps2": middle, "of_gravity": middle / GRAVITY_MPS2,
                        "standard_error_mps2": error, "flights": int(agree.sum()), "tilt_deg": tilt})  # fmt: skip
    spans = (seen[int(np.argmax(agree))].span,)
    if tilt > TILT_DEG:
        problem = "things do not fall along -z"
        yield Finding("warning", "free_fall", f"{problem}: {tilt:.0f} deg away from it", None, "object_pose", None,
                      problem, spans, evidence, "turn the poses so that z points up")  # fmt: skip
    if off > max(TOLD, SURE * error / GRAVITY_MPS2):
        level: Level = "error" if off > WRONG else "warning" if off > DOUBTFUL else "info"
        problem = "free flight is not free fall"
        text = f"{problem}: {middle:.4g} +- {error:.2g} m/s2 in {agree.sum()} flights, {middle / GRAVITY_MPS2:.3f} of "
        text += (
            f"gravity: lengths read {middle / GRAVITY_MPS2:.3f} of true, or time {np.sqrt(GRAVITY_MPS2 / middle):.3f}"
        )
        yield Finding(level, "free_fall", text, None, "object_pose", None, problem, spans, evidence, REMEDY)


RULE = Rule(
    meaning="free flight is free fall", gather=_gather, judge=_judge, needs=("object_pose",),
    idle="nothing flies freely, or it is not known when it is touched",
)  # fmt: skip
