"""Rule: velocities are those of the positions beside them: unit, sign, frame, order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.checks._signal import UNITS, smooth, unit_of
from candata.checks._view import View, rounded
from candata.rotation import conjugate, log, multiply, normalise, rotate

Array = NDArray[np.float64]
#: Correlation from which stated and differenced velocity are of one motion.
ALIKE = 0.8
#: Ratios of their sizes that are no unit's, and nearness to a unit's factor as a difference of logarithms.
PLAIN, NEAR = 4.0, 0.2
#: By how much the world's frame must fit better than the body's, and how well.
BETTER, WELL = 3.0, 0.3
#: Time over which both are averaged [s], at least three rows: differences are noisy.
OVER_S = 0.02
#: Units of velocities that people mix up: thousandths, hundredths, degrees.
UNITS_OF_RATES = (*list(UNITS)[:2], list(UNITS)[-1])
#: Share of episodes that must agree.
MOST = 0.6


@dataclass(frozen=True)
class _Rates:
    """What an episode tells of its velocities.

    Attributes
    ----------
    ratios : dict of (str, str) to (float, float)
        Channel and element to stated over differenced, signed by their correlation, where they are alike.
    idle : dict of (str, str) to bool
        Channel and element: zero throughout while the position moves.
    spin : (float, float)
        Misfit of the angular velocity as the body's and as the world's; NaN where there is none.
    """

    ratios: dict[tuple[str, str], float]
    idle: dict[tuple[str, str], bool]
    spin: tuple[float, float]


def _gather(view: View) -> _Rates | None:
    """Return what an episode tells of its velocities; None where it has none beside positions."""
    if view.time_s is None or len(view.time_s) < 12:
        return None
    found = _Rates({}, {}, (np.nan, np.nan))
    joint, rate = view.values("joint_position"), view.values("joint_velocity")
    if joint is not None and rate is not None and joint.shape == rate.shape:
        _columns(view, found, "joint_velocity", joint, rate, view.elements("joint_position"))
    pose, velocity = view.whole("object_pose"), view.whole("object_velocity")
    if pose is not None and velocity is not None:
        _columns(view, found, "object_velocity", pose[:, :3], velocity[:, :3], ("x", "y", "z"))
        found = replace(found, spin=_frame(view, pose, velocity[:, 3:]))
    return found if found.idle or np.isfinite(found.spin[0]) else None


def _judge(seen: Sequence[_Rates]) -> Iterator[Finding]:
    """Yield velocities that do not belong to their positions, in most episodes."""
    for channel, name in dict.fromkeys(key for one in seen for key in one.idle):
        key = channel, name
        if all(one.idle[key] for one in seen if key in one.idle):
            problem = "a velocity is zero throughout while its position moves"
            yield _told("info", channel, problem, name, "zero by construction, or not measured: leave it out of models")
        ratios = np.array([one.ratios[key] for one in seen if key in one.ratios])
        if not len(ratios):
            continue
        ratio = float(np.median(np.abs(ratios)))
        if (ratios < 0).mean() > MOST:
            yield _told("warning", channel, "a velocity has the other sign", name, "turn the sign of one of them")
        elif unit_of(ratio, NEAR) in UNITS_OF_RATES and max(ratio, 1 / ratio) > PLAIN:
            text = f"{name} is {ratio:.4g} times the position's, as in {unit_of(ratio, NEAR)}"
            remedy = "give units in the map, or correct rate_hz"
            yield _told("error", channel, "a velocity is in another unit", text, remedy, ratio=ratio)
    spins = np.array([one.spin for one in seen if np.isfinite(one.spin).all()]).reshape(-1, 2)
    world = (spins[:, 0] > BETTER * spins[:, 1]) & (spins[:, 1] < WELL)
    if len(spins) and world.mean() > MOST:
        body, other = np.median(spins, axis=0)
        text = f"misfit {other:.2f} when read so, {body:.2f} as the body's, in {world.sum()} of {len(spins)} episodes"
        problem, remedy = "the angular velocity is in the world's frame", "turn it into the body's frame"
        yield _told("warning", "object_velocity", problem, text, remedy, misfit_body=body, misfit_world=other)


def _told(level: Level, channel: str, problem: str, detail: str, remedy: str, **evidence: float) -> Finding:
    """Return a finding of the whole set."""
    return Finding(
        level, "velocities", f"{problem}: {detail}", None, channel, None, problem, (), rounded(evidence), remedy
    )


def _averaged(view: View, position: Array, velocity: Array) -> tuple[Array, Array]:
    """Return differenced and stated velocity, averaged over the same rows."""
    time_s = np.zeros(0) if view.time_s is None else view.time_s
    rows = max(3, round(OVER_S * view.rate_hz))
    differenced = np.diff(position, axis=0) / np.diff(time_s)[:, None]
    # Some state the velocity of the step that ends in a row, some that of the row: the mean of two suits both.
    return smooth(differenced, rows), smooth(0.5 * (velocity[1:] + velocity[:-1]), rows)


def _columns(view: View, found: _Rates, channel: str, position: Array, velocity: Array, names: tuple[str, ...]) -> None:
    """Note which columns are zero beside a moving position, and the ratios of those that are alike."""
    differenced, stated = _averaged(view, position, velocity)
    seen = np.isfinite(differenced) & np.isfinite(stated)
    for k, name in enumerate(names):
        a, b = differenced[seen[:, k], k], stated[seen[:, k], k]
        if len(a) < 10 or a.std() == 0:
            continue
        found.idle[channel, name] = not np.nan_to_num(velocity[:, k]).any()
        correlation = float(np.corrcoef(a, b)[0, 1]) if b.std() > 0 else 0.0
        if abs(correlation) > ALIKE:
            found.ratios[channel, name] = float(np.sign(correlation) * b.std() / a.std())


def _frame(view: View, pose: Array, spin: Array) -> tuple[float, float]:
    """Return the misfit of the angular velocity as the body's and as the world's."""
    _, stated = _averaged(view, np.zeros_like(spin), spin)
    quaternion = pose[:, 3:]
    return _misfit(turning(view, quaternion), stated), _misfit(turning(view, quaternion, world=True), stated)


def turning(view: View, quaternion: Array, world: bool = False) -> Array:
    """Return `(T - 1, 3)` angular velocity [rad/s] by differences, in the body's or the world's frame, averaged."""
    time_s = np.zeros(0) if view.time_s is None else view.time_s
    q = normalise(quaternion)
    step = log(multiply(conjugate(q[:-1]), q[1:])) / np.diff(time_s)[:, None]
    return smooth(rotate(q[:-1], step) if world else step, max(3, round(OVER_S * view.rate_hz)))


def _misfit(found: Array, stated: Array) -> float:
    """Return the rms difference over the rms of what is stated; NaN where that is zero or nothing is seen."""
    seen = np.isfinite(found).all(axis=1) & np.isfinite(stated).all(axis=1)
    size = float(np.sqrt((stated[seen] ** 2).sum()))
    return float(np.sqrt(((found - stated)[seen] ** 2).sum()) / size) if size > 0 else float("nan")


RULE = Rule(meaning="velocities are those of the positions", gather=_gather, judge=_judge)
