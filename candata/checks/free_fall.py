"""Rule: what flies freely falls freely: with the scene's gravity, or 9.81 m/s2 along -z.

An object flies while nothing holds it: no flag is on, no fingertip reads more than it reads at rest, it is away from
the height at which it rests, and it turns as a body without torque does. Then its place is a parabola to within noise
over a window of rows, and it moves on along its own acceleration: what slides or rolls out moves against it. Such a
window counts where it points as gravity does, and as a sign of a turned frame where it is as strong as gravity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.checks._forces import any_contact, feels_force
from candata.checks._signal import noise, spread
from candata.checks._view import EpisodeView, round_evidence
from candata.rotation import conjugate, log, multiply, normalise

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Standard gravity [m/s^2] (CGPM 1901).
GRAVITY_MPS2 = 9.80665
#: Windows: fewest rows, shortest and longest time [s] (a fall of 4.9 m), growth from one length to the next.
ROWS, SHORTEST_S, LONGEST_S, GROWTH = 8, 0.05, 1.0, 1.3
#: A fall is one from here on [m], and in noises of the tracker, of which it must stand clear. Chosen.
FALLEN_M, FALLEN_NOISES = 0.01, 20.0
#: Time over which what rests keeps its height [s], and the distance from that height at which no support is near [m],
#: also in noises: at the top of a throw a third of gravity moves things by 16 mm in that time. Chosen.
REST_S, AWAY_M, AWAY_NOISES = 0.2, 0.005, 6.0
#: Smallest acceleration that is a flight, as a share of gravity.
LEAST_SHARE = 0.25
#: A window is a parabola when its residual is within so many times the noise, or this [m].
RESIDUAL_NOISES, RESIDUAL_M = 1.5, 2e-5
#: What tips over an edge turns ever faster, by its acceleration over its distance from that edge; what flies does not.
#: Angular acceleration, as a share of that at so small a distance [m], up to which something flies, and how many noises
#: of the tracker its turn may differ by. Chosen: a box that tumbles at 10 rad/s changes by half as much.
TURNS, SMALL_M, TURNS_NOISES = 0.2, 0.02, 6.0
#: Largest standard error of one flight, as a share.
ERROR = 0.1
#: Flights that agree: within this share of their median, and so many standard errors; the share of them that must.
AGREE_SHARE, ERRORS, AGREEING_SHARE = 0.06, 3.0, 0.7
#: Differences from gravity that are reported, doubtful and wrong, as shares.
TOLD_SHARE, DOUBTFUL_SHARE, WRONG_SHARE = 0.015, 0.05, 0.2
#: Standard errors by which the median of all flights must be off.
SURE_ERRORS = 4.0
#: Fewest flights for a finding; an episode that differs from the others by this share, among this share that agree.
FEWEST, APART_SHARE, NEARLY_ALL = 3, 0.12, 0.85
#: Angle to gravity up to which a fall is one [deg]: trackers are set up by eye. Chosen.
TILT_DEG = 5.0
REMEDY = "check the unit and scale of the poses, the rate, and whether z points up"


@dataclass(frozen=True)
class _Flight:
    """The surest flight of an episode.

    Attributes
    ----------
    id : str
    acceleration : (3,) float64
        [m/s^2].
    error : float
        Its standard error, as a share.
    span : (float, float)
        From when to when [s].
    gravity : (3,) float64
        What it should be [m/s^2].
    """

    id: str
    acceleration: Array
    error: float
    span: tuple[float, float]
    gravity: Array

    @property
    def size(self) -> float:
        """Size of the acceleration [m/s^2]."""
        return float(np.linalg.norm(self.acceleration))

    @property
    def falls(self) -> bool:
        """Whether the acceleration points along gravity, within its error."""
        return bool(_angles_deg(self.acceleration[None], self.gravity)[0] < _tilt_deg(self.error))


def _gather(view: EpisodeView) -> _Flight | None:
    """Return the longest flight of an episode; None where nothing flies."""
    pose, may_be_held = view.complete_values("object_pose"), _held_rows(view)
    gravity = np.r_[0.0, 0.0, -GRAVITY_MPS2] if view.scene is None else np.array(view.scene.model.opt.gravity, float)
    if pose is None or view.time_s is None or may_be_held is None or not gravity.any():
        return None
    step = 1 / view.rate_hz
    is_even = np.abs(np.diff(view.time_s, prepend=-step) - step) < 0.2 * step
    free = np.isfinite(pose[:, 0]) & ~may_be_held & is_even
    is_unsupported = _unsupported_rows(pose, view.rate_hz, hand="action" in view.raw.arrays)
    is_unsupported &= _before_impact(np.nan_to_num(pose[:, 2]), free)
    flights: list[_Flight] = []
    rows = max(ROWS, int(np.ceil(SHORTEST_S / step)))
    while rows <= min(len(pose), max(ROWS, LONGEST_S / step)):
        flight = _surest(view, pose, free, is_unsupported, rows, gravity)
        if flight is None:
            break
        flights.append(flight)
        rows = int(np.ceil(GROWTH * rows))
    # The longest window may reach into an impact; the one before it does not, or less.
    return flights[max(0, len(flights) - 2)] if flights and flights[max(0, len(flights) - 2)].error < ERROR else None


def _tilt_deg(error: Array | float) -> Array | float:
    """Return the angle to gravity up to which a flight of a standard error, as a share, falls along it."""
    return TILT_DEG + np.degrees(ERRORS * error)


def _held_rows(view: EpisodeView) -> Mask | None:
    """Return `(T,) bool`: rows in which something may hold the object; None where that is not known beside a hand."""
    touch, is_pressed = any_contact(view), feels_force(view)
    if touch is None and is_pressed is None:
        return None if "action" in view.raw.arrays else np.zeros(len(view.raw.arrays["time_ns"]), bool)
    is_flagged = np.zeros(len(view.raw.arrays["time_ns"]), bool) if touch is None else ~(touch == 0)
    return is_flagged if is_pressed is None else is_flagged | is_pressed


def _unsupported_rows(pose: Array, rate_hz: float, hand: bool) -> Mask:
    """Return `(T,) bool`: rows at another height than any at which the object rests: no support is near.

    Where it never rests, nothing is known beside a hand; without one it was recorded in flight.
    """
    z, rows = pose[:, 2], max(2, round(REST_S * rate_hz))
    tolerance = max(AWAY_M, AWAY_NOISES * float(noise(pose[:, 2:3])[0]))
    if len(z) < rows:
        return np.full(len(z), not hand)
    windows = np.lib.stride_tricks.sliding_window_view(z, rows)
    levels = np.sort(windows.mean(axis=1)[np.ptp(windows, axis=1) < tolerance])
    if not len(levels):
        return np.full(len(z), not hand)
    lower_level = np.clip(np.searchsorted(levels, z), 1, len(levels)) - 1
    upper_level = np.minimum(lower_level + 1, len(levels) - 1)
    return np.asarray(np.minimum(np.abs(z - levels[lower_level]), np.abs(z - levels[upper_level])) > tolerance)


def _before_impact(height: Array, free: Mask) -> Mask:
    """Return `(T,) bool`: rows of each free stretch until a fall first ends; what bounces may slide as well."""
    keep = np.zeros(len(height), bool)
    for start, end in np.flatnonzero(np.diff(np.r_[False, free, False].astype(np.int8))).reshape(-1, 2):
        z = height[start:end]
        fall = np.maximum.accumulate(z) - z
        rise = z - np.minimum.accumulate(np.where(fall > FALLEN_M, z, np.inf))
        stop = np.flatnonzero((rise > 0.2 * FALLEN_M) | (_slow_rows(z) & (fall > FALLEN_M)))
        keep[start : start + int(stop[0]) if len(stop) else end] = True
    return keep


def _slow_rows(z: Array) -> Mask:
    """Return rows after which the height hardly changes any more, against its fastest row so far."""
    step = np.abs(np.diff(z, append=z[-1:]))
    return np.asarray(step < 0.3 * np.maximum.accumulate(step))


def _surest(
    view: EpisodeView, pose: Array, free: Mask, is_unsupported: Mask, rows: int, gravity: Array
) -> _Flight | None:
    """Return the flight in the window of so many rows that is the best parabola; None where none is."""
    half_s, noise_level = 0.5 * (rows - 1) / view.rate_hz, float(np.median(noise(pose[:, :3])))
    speed, acceleration, residual, curve = _parabolas(np.nan_to_num(pose[:, :3]), rows, half_s)
    size, off_deg = np.linalg.norm(acceleration, axis=1), _angles_deg(acceleration, gravity)
    straight = _fall_lengths(speed, acceleration, half_s) > max(FALLEN_M, FALLEN_NOISES * noise_level)
    straight &= (size > LEAST_SHARE * GRAVITY_MPS2) & (residual < max(RESIDUAL_NOISES * noise_level, RESIDUAL_M))
    error = np.maximum(noise_level, residual) * curve / np.maximum(size, 1e-12)
    straight &= _torque_free_windows(pose[:, 3:], rows, size * half_s**2)
    is_down = off_deg < _tilt_deg(error)
    falls = straight & _full_windows(free & is_unsupported, rows) & is_down
    is_sideways = (
        straight & _full_windows(free, rows) & ~is_down & (np.abs(size / np.linalg.norm(gravity) - 1) < WRONG_SHARE)
    )
    is_flight = falls if falls.any() else is_sideways
    if not is_flight.any():
        return None
    k = int(np.argmin(np.where(is_flight, residual, np.inf)))
    time_s = np.zeros(0) if view.time_s is None else view.time_s
    return _Flight(view.id, acceleration[k], float(error[k]), (float(time_s[k]), float(time_s[k + rows - 1])), gravity)


def _full_windows(is_free: Mask, rows: int) -> Mask:
    """Return `(W,) bool`: windows in which all rows are true."""
    return np.asarray(np.convolve(is_free, np.ones(rows), "valid") > rows - 0.5)


def _parabolas(place: Array, rows: int, half_s: float) -> tuple[Array, Array, Array, float]:
    """Return what the parabola through each window of `(T, 3)` places says.

    Speed in the middle and acceleration `(W, 3)`, the largest residual of an axis `(W,)`, and the acceleration's
    standard error for a residual of 1. By sums over rows: windows side by side would not fit into memory where
    recordings are long.
    """
    x = np.linspace(-1, 1, rows)
    basis, _ = np.linalg.qr(np.stack([np.ones(rows), x, x**2], axis=1))
    centred_place = place - place.mean(axis=0)
    parts = np.stack([_sums(centred_place, column) for column in basis.T], axis=-1)
    residual_squares = np.maximum(_sums(centred_place**2, np.ones(rows)) - (parts**2).sum(axis=-1), 0)
    # A column of the basis is its power of x, less lower ones, over this (signed) length.
    line, curve = 1 / float(basis[:, 1] @ x) / half_s, 2 / float(basis[:, 2] @ x**2) / half_s**2
    return parts[..., 1] * line, parts[..., 2] * curve, np.sqrt(residual_squares / (rows - 3)).max(axis=1), abs(curve)


def _sums(values: Array, weights: Array) -> Array:
    """Return `(W, N)` the weighted sums over each window of `(T, N)` values."""
    return np.stack([np.convolve(column, weights[::-1], "valid") for column in values.T], axis=1)


def _fall_lengths(speed: Array, acceleration: Array, half_s: float) -> Array:
    """Return `(W,)` how far each parabola goes on along its own acceleration [m], from its top on."""
    size = np.maximum(np.linalg.norm(acceleration, axis=1), 1e-12)
    speed_along = (speed * acceleration).sum(axis=1) / size
    first_speed, last_speed = np.maximum(speed_along - size * half_s, 0), np.maximum(speed_along + size * half_s, 0)
    return np.asarray((last_speed**2 - first_speed**2) / (2 * size))


def _torque_free_windows(quaternion: Array, rows: int, moved_m: Array) -> Mask:
    """Return `(W,) bool`: windows whose halves turn alike, as without torque.

    Parameters
    ----------
    moved_m : (W,) float64
        Acceleration times the square of half a window's time [m].
    """
    q = normalise(np.where(np.isfinite(quaternion), quaternion, np.array([1.0, 0, 0, 0])))
    steps = log(multiply(conjugate(q[:-1]), q[1:]))
    turn_noise = float(np.linalg.norm(noise(np.cumsum(steps, axis=0))))
    total_turn = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    start = np.arange(len(q) - rows + 1)
    middle_turn, end = total_turn[start + (rows - 1) // 2], total_turn[start + 2 * ((rows - 1) // 2)]
    turn_change = np.linalg.norm(end - 2 * middle_turn + total_turn[start], axis=1)
    return np.asarray(turn_change < np.maximum(TURNS * moved_m / SMALL_M, TURNS_NOISES * turn_noise))


def _angles_deg(vectors: Array, axis: Array) -> Array:
    """Return `(W,)` the angles between vectors `(W, 3)` and an axis [deg]."""
    size = np.maximum(np.linalg.norm(vectors, axis=1) * np.linalg.norm(axis), 1e-12)
    return np.asarray(np.degrees(np.arccos(np.clip(vectors @ axis / size, -1, 1))))


def _judge(flights: Sequence[_Flight]) -> Iterator[Finding]:
    """Yield what all flights say of gravity, and flights that differ from all others."""
    falls, sideways_flights = ([flight for flight in flights if flight.falls is kind] for kind in (True, False))
    if len(sideways_flights) >= FEWEST and len(sideways_flights) > len(falls):
        yield from _direction(sideways_flights)
        return
    size = np.array([flight.size for flight in falls])
    errors = np.array([flight.error for flight in falls])
    median_size = float(np.median(size)) if falls else 0.0
    agree = np.abs(size / median_size - 1) < AGREE_SHARE + ERRORS * errors if falls else np.zeros(0, bool)
    if len(falls) < FEWEST or agree.mean() < AGREEING_SHARE:
        reason = "too few flights" if len(falls) < FEWEST else "flights do not agree on any acceleration"
        yield Finding("unknown", "free_fall", reason, problem=reason)
        return
    yield from _gravity([flight for flight, a in zip(falls, agree, strict=True) if a])
    if agree.mean() >= NEARLY_ALL:
        is_apart = ~agree & (np.abs(size / median_size - 1) > np.maximum(APART_SHARE, 6 * errors))
        for k in np.flatnonzero(is_apart).tolist():
            problem = "a flight is not as the others"
            yield Finding(
                "warning",
                "free_fall",
                f"{problem}: {size[k]:.3g} m/s2 where the others have {median_size:.3g}",
                episode=falls[k].id,
                channel="object_pose",
                problem=problem,
                ranges=(falls[k].span,),
                evidence=round_evidence({"acceleration_mps2": size[k], "others_mps2": median_size}),
                remedy=REMEDY,
            )


def _direction(flights: Sequence[_Flight]) -> Iterator[Finding]:
    """Yield that things fall as fast as by gravity, but all in another direction."""
    mean = np.median([flight.acceleration / flight.size for flight in flights], axis=0)
    angles_deg = _angles_deg(np.stack([flight.acceleration for flight in flights]), mean)
    if np.median(angles_deg) > TILT_DEG:
        reason = "flights do not agree on any direction"
        yield Finding("unknown", "free_fall", reason, problem=reason)
        return
    tilt = float(_angles_deg(mean[None], flights[0].gravity)[0])
    problem = "things do not fall along gravity"
    yield Finding(
        "warning",
        "free_fall",
        f"{problem}: {tilt:.0f} deg away from it in {len(flights)} flights",
        channel="object_pose",
        problem=problem,
        ranges=(flights[0].span,),
        evidence=round_evidence({"tilt_deg": tilt, "flights": len(flights)}),
        remedy="turn the poses so that z points up",
    )


def _gravity(flights: Sequence[_Flight]) -> Iterator[Finding]:
    """Yield that things fall with another acceleration than gravity."""
    sizes, gravity = np.array([flight.size for flight in flights]), float(np.linalg.norm(flights[0].gravity))
    median_size = float(np.median(sizes))
    # The median of normal values has 1.2533 times the error of their mean (Kendall and Stuart 1977, section 10.10).
    error = float(1.2533 * spread(sizes) / np.sqrt(len(sizes)))
    deviation = abs(median_size / gravity - 1)
    if deviation <= max(TOLD_SHARE, SURE_ERRORS * error / gravity):
        return
    level: Level = "error" if deviation > WRONG_SHARE else "warning" if deviation > DOUBTFUL_SHARE else "info"
    problem = "free flight is not free fall"
    text = f"{problem}: {median_size:.4g} +- {error:.2g} m/s2 in {len(flights)} flights, "
    text += f"{median_size / gravity:.3f} of gravity: "
    text += f"lengths read {median_size / gravity:.3f} of true, or time {np.sqrt(gravity / median_size):.3f}"
    evidence = {"acceleration_mps2": median_size, "of_gravity": median_size / gravity, "standard_error_mps2": error}
    yield Finding(
        level,
        "free_fall",
        text,
        channel="object_pose",
        problem=problem,
        ranges=(flights[0].span,),
        evidence=round_evidence(evidence | {"flights": len(flights)}),
        remedy=REMEDY,
    )


RULE = Rule(
    meaning="free flight is free fall",
    gather=_gather,
    judge=_judge,
    needs=("object_pose",),
    idle_reason="nothing flies freely, or it is not known when it is touched",
)
