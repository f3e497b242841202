"""Rule: velocities are those of the positions beside them: unit, sign, frame, order."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._signal import smooth, unit_of
from candata.checks._view import View
from candata.rotation import conjugate, log, multiply, normalise, rotate

Array = NDArray[np.float64]
#: Correlation from which stated and differenced velocity are of one motion.
ALIKE = 0.8
#: Ratios of their sizes that are no unit's.
PLAIN = (0.5, 2.0)
#: By how much the world's frame must fit better than the body's.
BETTER = 3.0
#: Time over which both are averaged [s], at least three rows: differences are noisy.
OVER_S = 0.02


def _episode(view: View) -> Iterator[Finding]:
    """Yield velocities that do not belong to their positions."""
    if view.time_s is None or len(view.time_s) < 12:
        return
    joint, rate = view.values("joint_position"), view.values("joint_velocity")
    if joint is not None and rate is not None and joint.shape == rate.shape:
        yield from _columns(view, "joint_velocity", joint, rate, view.elements("joint_position"))
    pose, velocity = view.whole("object_pose"), view.whole("object_velocity")
    if pose is not None and velocity is not None:
        yield from _columns(view, "object_velocity", pose[:, :3], velocity[:, :3], ("x", "y", "z"))
        yield from _frame(view, pose, velocity[:, 3:])


def _averaged(view: View, position: Array, velocity: Array) -> tuple[Array, Array]:
    """Return differenced and stated velocity, averaged over the same rows."""
    time_s = np.zeros(0) if view.time_s is None else view.time_s
    rows = max(3, round(OVER_S * view.rate_hz))
    differenced = np.diff(position, axis=0) / np.diff(time_s)[:, None]
    # Some state the velocity of the step that ends in a row, some that of the row: the mean of two suits both.
    return smooth(differenced, rows), smooth(0.5 * (velocity[1:] + velocity[:-1]), rows)


def _columns(view: View, channel: str, position: Array, velocity: Array, names: tuple[str, ...]) -> Iterator[Finding]:
    """Yield columns of zeros beside a moving position, and columns in another unit or of the other sign."""
    differenced, stated = _averaged(view, position, velocity)
    zero = [k for k in range(position.shape[1]) if not np.nan_to_num(velocity[:, k]).any()]
    idle = [names[k] for k in zero if np.nan_to_num(np.abs(differenced[:, k])).max() > 0]
    if idle:
        yield view.finding(
            "info", "velocities", "a velocity is zero throughout while the position moves", ", ".join(idle), channel,
            remedy="zero by construction, or not measured: leave the column out of models", elements=", ".join(idle),
        )  # fmt: skip
    seen = np.isfinite(differenced) & np.isfinite(stated)
    for k, name in enumerate(names):
        a, b = differenced[seen[:, k], k], stated[seen[:, k], k]
        if len(a) < 10 or a.std() == 0 or b.std() == 0:
            continue
        correlation, ratio = float(np.corrcoef(a, b)[0, 1]), float(b.std() / a.std())
        if correlation < -ALIKE:
            yield view.finding(
                "warning", "velocities", f"a velocity has the other sign: {name}", f"correlation {correlation:.2f}",
                channel, remedy="turn the sign of one of them", correlation=correlation,
            )  # fmt: skip
        elif correlation > ALIKE and not PLAIN[0] < ratio < PLAIN[1]:
            unit = unit_of(ratio)
            text = f"{ratio:.4g} times the position's" + (f", as in {unit}" if unit else "")
            yield view.finding(
                "error" if unit else "warning", "velocities", f"a velocity is in another unit: {name}", text, channel,
                remedy="give units in the map, or correct rate_hz", ratio=ratio, correlation=correlation,
            )  # fmt: skip


def _frame(view: View, pose: Array, spin: Array) -> Iterator[Finding]:
    """Yield that the angular velocity is the world's, or fits the orientation only when read in another order."""
    body = turning(view, pose[:, 3:])
    world = turning(view, pose[:, 3:], world=True)
    _, stated = _averaged(view, np.zeros_like(spin), spin)
    own, other = (_misfit(x, stated) for x in (body, world))
    if own > BETTER * other and other < 0.3:
        yield view.finding(
            "warning", "velocities", "the angular velocity is in the world's frame", f"misfit {other:.2f}, as the "
            f"body's {own:.2f}", "object_velocity", remedy="turn it into the body's frame", misfit_body=own,
            misfit_world=other,
        )  # fmt: skip


def turning(view: View, quaternion: Array, world: bool = False) -> Array:
    """Return `(T - 1, 3)` angular velocity [rad/s] by differences, in the body's or the world's frame, averaged."""
    time_s = np.zeros(0) if view.time_s is None else view.time_s
    q = normalise(quaternion)
    step = log(multiply(conjugate(q[:-1]), q[1:])) / np.diff(time_s)[:, None]
    return smooth(rotate(q[:-1], step) if world else step, max(3, round(OVER_S * view.rate_hz)))


def _misfit(found: Array, stated: Array) -> float:
    """Return the rms difference over the rms of what is stated; infinite where that is zero or nothing is seen."""
    seen = np.isfinite(found).all(axis=1) & np.isfinite(stated).all(axis=1)
    size = float(np.sqrt((stated[seen] ** 2).sum()))
    return float(np.sqrt(((found - stated)[seen] ** 2).sum()) / size) if size > 0 else float("inf")


RULE = Rule(meaning="velocities are those of the positions", episode=_episode)
