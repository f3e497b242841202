"""Rule: velocities are those of the positions beside them: unit, sign, frame, order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.checks._signal import UNITS, moving_mean, unit_of
from candata.checks._view import EpisodeView, round_evidence
from candata.rotation import conjugate, log, multiply, normalise, rotate

Array = NDArray[np.float64]
#: Correlation from which stated and differenced velocity are of one motion.
LEAST_CORRELATION = 0.8
#: Ratios of their sizes that are no unit's, and nearness to a unit's factor as a difference of logarithms.
LARGEST_PLAIN_RATIO, UNIT_NEARNESS = 4.0, 0.2
#: By how much the world's frame must fit better than the body's, and how well.
BETTER_TIMES, WELL_MISFIT = 3.0, 0.3
#: Time over which both are averaged [s], at least three rows: differences are noisy.
OVER_S = 0.02
#: Units of velocities that people mix up: thousandths, hundredths, degrees.
UNITS_OF_RATES = (*list(UNITS)[:2], list(UNITS)[-1])
#: Share of episodes that must agree.
AGREEING_SHARE = 0.6


@dataclass(frozen=True)
class _Rates:
    """Velocities of an episode against its positions.

    Attributes
    ----------
    ratios : dict of (str, str) to (float, float)
        Channel and element to stated over differenced, signed by their correlation, where they are alike.
    is_zero : dict of (str, str) to bool
        Channel and element: zero throughout while the position moves.
    spin : (float, float)
        Misfit of the angular velocity as the body's and as the world's; NaN where there is none.
    """

    ratios: dict[tuple[str, str], float]
    is_zero: dict[tuple[str, str], bool]
    spin: tuple[float, float]


def _gather(view: EpisodeView) -> _Rates | None:
    """Return what an episode tells of its velocities; None where it has none beside positions."""
    if view.time_s is None or len(view.time_s) < 12:
        return None
    rates = _Rates({}, {}, (np.nan, np.nan))
    joint, rate = view.values("joint_position"), view.values("joint_velocity")
    if joint is not None and rate is not None and joint.shape == rate.shape:
        _columns(view, rates, "joint_velocity", joint, rate, view.elements("joint_position"))
    pose, velocity = view.complete_values("object_pose"), view.complete_values("object_velocity")
    if pose is not None and velocity is not None:
        _columns(view, rates, "object_velocity", pose[:, :3], velocity[:, :3], ("x", "y", "z"))
        rates = replace(rates, spin=_frame(view, pose, velocity[:, 3:]))
    return rates if rates.is_zero or np.isfinite(rates.spin[0]) else None


def _judge(episodes: Sequence[_Rates]) -> Iterator[Finding]:
    """Yield velocities that do not belong to their positions, in most episodes."""
    for channel, name in dict.fromkeys(key for episode in episodes for key in episode.is_zero):
        key = channel, name
        if all(episode.is_zero[key] for episode in episodes if key in episode.is_zero):
            problem = "a velocity is zero throughout while its position moves"
            yield _set_finding(
                "info", channel, problem, name, "zero by construction, or not measured: leave it out of models"
            )
        ratios = np.array([episode.ratios[key] for episode in episodes if key in episode.ratios])
        if not len(ratios):
            continue
        ratio = float(np.median(np.abs(ratios)))
        if (ratios < 0).mean() > AGREEING_SHARE:
            yield _set_finding(
                "warning", channel, "a velocity has the other sign", name, "turn the sign of one of them"
            )
        elif unit_of(ratio, UNIT_NEARNESS) in UNITS_OF_RATES and max(ratio, 1 / ratio) > LARGEST_PLAIN_RATIO:
            text = f"{name} is {ratio:.4g} times the position's, as in {unit_of(ratio, UNIT_NEARNESS)}"
            remedy = "give units in the map, or correct rate_hz"
            yield _set_finding("error", channel, "a velocity is in another unit", text, remedy, ratio=ratio)
    spins = np.array([episode.spin for episode in episodes if np.isfinite(episode.spin).all()]).reshape(-1, 2)
    fits_world = (spins[:, 0] > BETTER_TIMES * spins[:, 1]) & (spins[:, 1] < WELL_MISFIT)
    if len(spins) and fits_world.mean() > AGREEING_SHARE:
        body_misfit, world_misfit = np.median(spins, axis=0)
        text = f"misfit {world_misfit:.2f} when read so, {body_misfit:.2f} as the body's, "
        text += f"in {fits_world.sum()} of {len(spins)} episodes"
        problem, remedy = "the angular velocity is in the world's frame", "turn it into the body's frame"
        yield _set_finding(
            "warning", "object_velocity", problem, text, remedy, misfit_body=body_misfit, misfit_world=world_misfit
        )


def _set_finding(level: Level, channel: str, problem: str, detail: str, remedy: str, **evidence: float) -> Finding:
    """Return a finding of the whole set."""
    return Finding(
        level,
        "velocities",
        f"{problem}: {detail}",
        channel=channel,
        problem=problem,
        evidence=round_evidence(evidence),
        remedy=remedy,
    )


def _average_velocities(view: EpisodeView, position: Array, velocity: Array) -> tuple[Array, Array]:
    """Return differenced and stated velocity, averaged over the same rows."""
    time_s = np.zeros(0) if view.time_s is None else view.time_s
    rows = max(3, round(OVER_S * view.rate_hz))
    differences = np.diff(position, axis=0) / np.diff(time_s)[:, None]
    # Some state the velocity of the step that ends in a row, some that of the row: the mean of two suits both.
    return moving_mean(differences, rows), moving_mean(0.5 * (velocity[1:] + velocity[:-1]), rows)


def _columns(
    view: EpisodeView, rates: _Rates, channel: str, position: Array, velocity: Array, names: tuple[str, ...]
) -> None:
    """Add to `rates` which columns are zero while the position moves, and the ratios of those that are alike."""
    differenced_velocity, stated_velocity = _average_velocities(view, position, velocity)
    has_both = np.isfinite(differenced_velocity) & np.isfinite(stated_velocity)
    for k, name in enumerate(names):
        a, b = differenced_velocity[has_both[:, k], k], stated_velocity[has_both[:, k], k]
        if len(a) < 10 or a.std() == 0:
            continue
        rates.is_zero[channel, name] = not np.nan_to_num(velocity[:, k]).any()
        correlation = float(np.corrcoef(a, b)[0, 1]) if b.std() > 0 else 0.0
        if abs(correlation) > LEAST_CORRELATION:
            rates.ratios[channel, name] = float(np.sign(correlation) * b.std() / a.std())


def _frame(view: EpisodeView, pose: Array, spin: Array) -> tuple[float, float]:
    """Return the misfit of the angular velocity as the body's and as the world's."""
    _, stated_spin = _average_velocities(view, np.zeros_like(spin), spin)
    quaternion = pose[:, 3:]
    return _misfit(angular_velocity(view, quaternion), stated_spin), _misfit(
        angular_velocity(view, quaternion, world=True), stated_spin
    )


def angular_velocity(view: EpisodeView, quaternion: Array, world: bool = False) -> Array:
    """Return `(T - 1, 3)` angular velocity [rad/s] by differences, in the body's or the world's frame, averaged."""
    time_s = np.zeros(0) if view.time_s is None else view.time_s
    q = normalise(quaternion)
    step = log(multiply(conjugate(q[:-1]), q[1:])) / np.diff(time_s)[:, None]
    return moving_mean(rotate(q[:-1], step) if world else step, max(3, round(OVER_S * view.rate_hz)))


def _misfit(differenced_spin: Array, stated_spin: Array) -> float:
    """Return the rms difference over the rms of what is stated; NaN where that is zero or nothing is seen."""
    has_both = np.isfinite(differenced_spin).all(axis=1) & np.isfinite(stated_spin).all(axis=1)
    size = float(np.sqrt((stated_spin[has_both] ** 2).sum()))
    return float(np.sqrt(((differenced_spin - stated_spin)[has_both] ** 2).sum()) / size) if size > 0 else float("nan")


RULE = Rule(meaning="velocities are those of the positions", gather=_gather, judge=_judge)
