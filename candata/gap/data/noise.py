"""The sensors' noise: measured where motions were repeated, declared by the scene, or read off quiet stretches."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings, block_rows
from candata.gap.data.repetition import repeated_pairs
from candata.gap.data.rounding import Readings, before_rounding, dithered, force_step, joint_step
from candata.gap.data.velocity import joint_velocity
from candata.gap.data.white_noise import (
    DEGREE,
    QUANTITIES,
    WINDOW,
    _turning,
    columns_of,
    variances,
    white_estimates,
    white_variance,
    windows_of,
)
from candata.schema.scene import Noise

Array = NDArray[np.float64]
NoiseKind = Literal["measured", "declared", "assumed"]
#: Smallest noise that is believed where none is declared: resolution of good encoders [rad], motion capture [m, rad]
#: and tactile sensors [N]; and that of encoders on rails [m].
SMALLEST = Noise(object_pose=(2e-4, 1e-3), joint_position=3e-4, fingertip_force=0.01)
SMALLEST_SLIDE_M = 5e-5
#: Times the declared noise that must be seen for it not to be believed. Record 43.
MORE = 1.3
#: Pairs of repeated episodes from which noise is measured. Chosen: one could be an accident.
PAIRS = 2
#: How near declared noise what is measured must come to confirm it. Record 43.
AS_DECLARED = 0.15
#: Significant digits of noise that is estimated: it is known no better, and two would be off by up to a twentieth.
DIGITS = 3
#: Standard error of an estimated noise over that of all windows' mean (there: 0.021 over 0.013), and by how many per
#: cent a mean loss rises where noise is one per cent larger (the Student-t loss of normal block means).
INEFFICIENCY, LOSS_PER_NOISE = 1.6, 1.7


class SensorNoise(NamedTuple):
    """Noise by which a recording is judged.

    Attributes
    ----------
    kind : str
        measured (in repeated motions), declared (by the scene), or assumed (from quiet stretches).
    noise : Noise
    notes : tuple of str
        Channels in which the recording is noisier than the scene declares.
    loss_error : float
        Relative standard error of a mean loss because the noise is estimated; 0 where it is as declared.
    """

    kind: NoiseKind
    noise: Noise
    notes: tuple[str, ...] = ()
    loss_error: float = 0.0


def sensor_noise(
    declared: Noise | None, recs: Recordings, replayed: Readings, slides: NDArray[np.bool_] | None = None
) -> SensorNoise:
    """Return the noise by which recordings are judged: measured, else declared, else assumed.

    Where a channel is clearly noisier than declared, what is seen counts: no effect explains noise. What is measured
    and confirms what is declared leaves that as it is, so that null replays made with it serve again.

    Parameters
    ----------
    declared : Noise or None
        What the scene says; none where all of it is zero.
    recs : Recordings
    replayed : dict of str to ndarray
        Readings of the nominal replay. Noise is read off the recording, and off what it differs by from its replay:
        motion adds to the one, a fault to the other, so the smaller counts.
    slides : (J,) bool, optional
        Which joints slide, as their noise is another quantity; none by default.
    """
    found = _of_quantities(declared, recs, replayed, slides)
    rates = _rate_noise(declared or Noise(), recs, replayed)
    return found._replace(noise=found.noise.model_copy(update=rates)) if rates else found


def _rate_noise(declared: Noise, recs: Recordings, replayed: Readings) -> dict[str, tuple[float, ...]]:
    """Return the noise of each joint's velocity and effort, where recorded: the larger of declared and seen.

    Both are that of a row of white noise with the blocks' true noise, which in firmware is filtered and rounded. A
    velocity is known as well as it agrees with the encoder's own rate; an effort as well as its blocks are even, in the
    recording or in what it differs by from its replay.
    """
    sizes: dict[str, Array] = {}
    rows = block_rows(recs.rate_hz)
    if "joint_velocity" in recs.readings:
        rate = joint_velocity(recs.readings["joint_position"], recs.rate_hz)
        error = _blocks(recs.readings["joint_velocity"] - rate, rows)
        known = np.isfinite(error)
        squares = np.where(known, error, 0.0) ** 2
        sizes["joint_velocity"] = np.sqrt(rows * squares.sum((0, 1)) / np.maximum(known.sum((0, 1)), 1))
    if "joint_effort" in recs.readings:
        effort = recs.readings["joint_effort"]
        apart = [_blocks(part, rows) for part in (effort, effort - replayed["joint_effort"])]
        white = [[white_variance(windows_of(part[..., j : j + 1])) for part in apart] for j in range(effort.shape[2])]
        sizes["joint_effort"] = np.sqrt(rows * np.min(white, axis=1))
    least = {"joint_velocity": declared.joint_velocity, "joint_effort": declared.joint_effort}
    return {
        name: tuple(_rough(recs.noise_factor * np.maximum(size, np.asarray(least[name]))).tolist())
        for name, size in sizes.items()
    }


def _blocks(values: Array, rows: int) -> Array:
    """Return values `(E, T, J)` as means of blocks `(E, B, J)`; NaN where a row is missing."""
    count = values.shape[1] // rows
    return np.asarray(values[:, : count * rows].reshape(len(values), count, rows, -1).mean(2))


def _of_quantities(
    declared: Noise | None, recs: Recordings, replayed: Readings, slides: NDArray[np.bool_] | None
) -> SensorNoise:
    """Return the noise of what `QUANTITIES` names, as `sensor_noise` does."""
    slides = _turning(recs) if slides is None else slides
    if declared is not None and recs.noise_factor != 1:
        declared = scaled_noise(declared, recs.noise_factor)
    told, least = _sizes(declared or Noise(), slides), _smallest(slides)
    step, joint_steps = force_step(recs.readings), joint_step(recs.readings)
    even = replace(recs, readings=dithered(recs.readings, step, joint_steps))
    pairs = repeated_pairs(recs)
    kind: NoiseKind = "measured" if len(pairs) >= PAIRS else "assumed"
    calm, calm_count = white_estimates(even, None, slides)
    variance, count = np.minimum(calm, variances(even, replayed, slides)), calm_count
    how = "seen in quiet stretches"
    if kind == "measured":
        first, second = (even.take(side) for side in np.array(pairs).T)
        variance, count = _agreed(*white_estimates(first, second.readings, slides), variance, count)
        how = "measured in repeated motions"
    steps = np.array([0.0, 0.0, *(_median(joint_steps[slides == kind]) for kind in (False, True)), step])
    seen = np.array([before_rounding(max(float(v) - s**2 / 12, 0.0), s) for v, s in zip(variance, steps, strict=True)])
    more = _with_rounding(seen, steps) > MORE * np.maximum(_with_rounding(told, steps), least)
    notes = tuple(
        f"noise of {name}: {a:.2g} {unit} declared, {b:.2g} {unit} {how}, and that counts"
        for (name, unit), a, b, louder in zip(QUANTITIES, told, seen, more, strict=True)
        if louder and told.any()
    )
    if joint_steps.any():
        widest = float(joint_steps.max())
        notes = (
            *notes,
            f"joint positions are whole multiples of a step, the widest {widest:.3g} rad or m: the floor holds it",
        )
    if kind == "assumed" and declared is not None and told.any():
        if not notes:
            return SensorNoise("declared", declared)
        noise = _noise(np.where(more, _rough(seen), told), declared.force_step, joint_steps, slides)
        return SensorNoise(
            "assumed" if more.any() else "declared",
            noise,
            notes,
            _loss_error(recs, slides, np.where(more, count, np.inf)),
        )
    recorded = np.array([columns_of(q, recs, slides) is not None for q, _ in QUANTITIES])
    confirmed = (kind == "measured") & (told > 0) & ((np.abs(seen - told) <= AS_DECLARED * told) | ~recorded)
    same_steps = (step == declared.force_step or not recorded[-1]) and not joint_steps.any() if declared else False
    if declared is not None and confirmed.all() and same_steps:
        return SensorNoise(kind, declared)
    sizes = np.where(confirmed, told, _rough(np.maximum(np.maximum(seen, least), told)))
    error = _loss_error(recs, slides, np.where(confirmed, np.inf, count))
    return SensorNoise(kind, _noise(sizes, step, joint_steps, slides), notes, error)


def scaled_noise(noise: Noise, factor: float) -> Noise:
    """Return noise as many times as large; steps of rounding, and what a tracker does, stay."""
    position, rotation = noise.object_pose
    changed: dict[str, object] = {
        "object_pose": (position * factor, rotation * factor),
        "fingertip_force": noise.fingertip_force * factor,
    }
    for name in ("joint_position", "joint_velocity", "joint_effort"):
        sizes = np.asarray(getattr(noise, name)) * factor
        changed[name] = tuple(sizes.tolist()) if sizes.ndim else float(sizes)
    return noise.model_copy(update=changed)


def _median(sizes: Array) -> float:
    """Return the median of sizes; 0 of none."""
    return float(np.median(sizes)) if sizes.size else 0.0


def _agreed(apart: Array, pairs: Array, variance: Array, count: Array) -> tuple[Array, Array]:
    """Return variances `(5,)` measured between repeats, and the windows that tell them.

    Few repeats tell less than all episodes' quiet stretches: where both agree, the mean by their numbers of windows.
    """
    measured = apart / 2
    agrees = np.abs(np.sqrt(measured) - np.sqrt(variance)) <= AS_DECLARED * np.sqrt(variance)
    both = (pairs * measured + count * variance) / np.maximum(pairs + count, 1)
    return np.where(agrees, both, measured), np.where(agrees, pairs + count, pairs)


def _loss_error(recs: Recordings, slides: NDArray[np.bool_], count: Array) -> float:
    """Return the relative standard error of a mean loss where noise is known from windows `(5,)` of each quantity."""
    columns = [columns_of(q, recs, slides) for q, _ in QUANTITIES]
    forces = recs.readings["fingertip_force"].shape[2] if "fingertip_force" in recs.readings else 0
    turning, sliding = (len(c) if isinstance(c, np.ndarray) else 0 for c in columns[2:4])
    pose = 3 if columns[0] is not None else 0
    width = np.array([pose, pose, turning, sliding, 3 * forces])
    error = INEFFICIENCY / np.sqrt(2 * (WINDOW - DEGREE - 1) * np.maximum(count, 1))
    share = width / max(width.sum(), 1)
    return float(LOSS_PER_NOISE * np.sqrt(((share * error) ** 2).sum()))


def _with_rounding(sizes: Array, steps: Array) -> Array:
    """Return `(5,)` sizes with what rounding to steps `(5,)` adds."""
    return np.hypot(sizes, steps / np.sqrt(12))


def _sizes(noise: Noise, slides: NDArray[np.bool_]) -> Array:
    """Return `(5,)` noise by quantity; that of several joints is their median."""
    joints = np.broadcast_to(noise.joint_position, slides.shape) if len(slides) else np.zeros(1)
    kinds = [joints[slides == kind] if len(slides) else joints for kind in (False, True)]
    turning, sliding = (float(np.median(each)) if each.size else float(np.median(joints)) for each in kinds)
    return np.array([*noise.object_pose, turning, sliding, noise.fingertip_force])


def _smallest(slides: NDArray[np.bool_]) -> Array:
    """Return `(5,)` the smallest noise that is believed, by quantity."""
    least = _sizes(SMALLEST, np.zeros(1, bool))
    least[3] = SMALLEST_SLIDE_M
    return least


def _rough(sizes: Array) -> Array:
    """Return sizes `(5,)` to the digits that are known of them."""
    return np.array([float(f"{s:.{DIGITS}g}") for s in sizes])


def _noise(sizes: Array, step: float, joint_steps: Array, slides: NDArray[np.bool_]) -> Noise:
    """Return noise of sizes `(5,)`: one number for all joints where they are of one kind; `joint_steps (J,)`."""
    position, rotation, turning, sliding, force = map(float, sizes)
    mixed = slides.any() and not slides.all()
    joints = tuple(np.where(slides, sliding, turning).tolist()) if mixed else sliding if slides.any() else turning
    return Noise(
        object_pose=(position, rotation),
        joint_position=joints,
        fingertip_force=force,
        force_step=step,
        joint_step=tuple(joint_steps.tolist()) if joint_steps.any() else 0.0,
    )
