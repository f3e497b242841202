"""Fingertip forces in another unit: told by the scene's own forces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.effects import effect
from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.mismatch.sensors import TOUCH_N, TOUCH_ROWS, free_spread, tare
from candata.gap.mismatch.unit_groups import ABOVE_NOISE, UNITS, mixed_findings
from candata.scenes import Scene
from candata.statistics import noise_sd
from candata.units import TO_SI

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Ratio of the largest to the smallest factor between fingertips up to which they share one.
ALIKE = 1.6
#: How far the factor may lie from a unit's where no noise tells, and how far that of the noise where it does.
ALONE, NOISE = 1.15, 1.5
#: How far from 1 `tactile_gain` is drawn: forces this near a unit's factor may be in that unit. Weak motors and slip
#: change forces as much.
DRAWN = 2.0
#: Ratio to the scene's forces beyond which it is another unit, known or not: five times the largest `tactile_gain`.
FORCE_RATIO = 30.0


def scale_findings(scene: Scene, recs: Recordings, force: Array) -> list[RecordingMismatch]:
    """Return that all fingertips read a multiple of the scene's forces that is another unit's, or no gain's.

    A unit scales the noise of free fingertips as well; a sensor that feels too little does not. So it is sure near a
    unit's factor where the noise has that factor too, and only at that factor where noise does not tell. Else it is
    noted, if it is near a unit's or if `tactile_gain` cannot explain it, unless noise is as declared in newtons.

    Parameters
    ----------
    force : (E, T, F, 3) float64
        Forces of a nominal replay [N].
    """
    if "fingertip_force" not in recs.readings:
        return []
    if mixed := mixed_findings(recs, force):
        return mixed
    real = recs.readings["fingertip_force"]
    each = _factors(real, force)
    factors = each[np.isfinite(each)]
    if not len(factors):
        return []
    if alone := _alone(scene, real, force, each):
        return [alone]
    times = float(np.median(factors))
    unit = _nearest(times)
    near, noise = _ratio(times * TO_SI[unit]), _noise_factor(scene, recs, force)
    # In newtons, free fingertips spread as declared; in another unit, nearer to `times` that.
    newton = noise is not None and _ratio(noise) < _ratio(noise / times)
    alike, told = factors.max() <= ALIKE * factors.min(), noise is not None and _ratio(noise * TO_SI[unit]) < NOISE
    if not alike and (newton or (np.log(factors) * np.sign(np.log(times))).min() < 0.5 * abs(np.log(times))):
        return []
    # A contact that the scene holds and the recording does not makes forces small without any unit.
    beyond = times > FORCE_RATIO or (1 / times > FORCE_RATIO and near < DRAWN and not newton)
    if beyond or (near < DRAWN and told) or (near < ALONE and alike and not newton):
        return [_unit(times, unit if near < DRAWN else "")]
    if near < (ALONE if newton else DRAWN):
        return [_doubtful(times, f"{unit} are {1 / TO_SI[unit]:.3g} times; `tactile_gain` explains it as well")]
    low, high = effect("tactile_gain").parameters[0].bounds(scene)
    # Near no unit: the scene holds what the recording does not, or the reverse.
    why = f"`tactile_gain` goes from {low:g} to {high:g}"
    return [] if low < times < high else [_doubtful(times, why, "force_gain")]


def tells_unit(real: Array, force: Array) -> bool:
    """Tell whether every fingertip of recorded forces `(E, T, F, 3)` reads what a gain makes of the scene's.

    What touches nothing gives no factor; one that is no gain's may be a unit's, or another contact's.
    """
    factors = _factors(real, force)
    return all(bool(np.isfinite(factor)) and _ratio(factor) < DRAWN for factor in factors.tolist())


def _alone(scene: Scene, real: Array, force: Array, factors: Array) -> RecordingMismatch | None:
    """Return that fingertips read in a unit of their own, noise and all, while the others do not; None if none do.

    A gain that one sensor alone may have leaves its noise where that of the others is. Without noise to tell, only the
    factor of a unit that no gain reaches is sure.
    """
    telling, noise = np.flatnonzero(np.isfinite(factors)), _noise(real, force)
    units: dict[int, str] = {}
    by_noise = False
    for f in telling if len(factors) > 1 else ():
        others, unit = np.median(np.delete(noise, f)), _nearest(factors[f])
        near = _ratio(factors[f] * TO_SI[unit])
        loud = _ratio(noise[f] / others * TO_SI[unit]) < NOISE if noise[f] > 0 and others > 0 else None
        if (loud and near < DRAWN) or (loud is None and near < ALONE and _ratio(factors[f]) > FORCE_RATIO):
            units[int(f)] = unit
            by_noise |= bool(loud)
    if not units or (len(units) == len(telling) and not by_noise):
        return None
    names = tuple(scene.file.fingertips[f] for f in units)
    told = ", ".join(
        f"{name} {factors[f]:.3g} times those ({u}: {1 / TO_SI[u]:.4g})"
        for name, (f, u) in zip(names, units.items(), strict=True)
    )
    return RecordingMismatch(
        "force_unit",
        True,
        "fingertip_force of some fingertips is not in newton",
        "forces near the scene's in contact, N, on every fingertip",
        told,
        "give the unit of their columns in map.yaml, or scale these to newtons",
        "fingertip_force",
        names,
    )


def _noise(real: Array, force: Array) -> Array:
    """Return `(F,)` the noise of each fingertip: of a free one where motions begin, else what bends from row to row."""
    tips = range(real.shape[2])
    return np.array(
        [free_spread(real[:, :, [f]], force[:, :, [f]]) or float(noise_sd(real[:, :, [f]], 1)) for f in tips]
    )


def _nearest(times: float) -> str:
    """Return the unit in which forces come nearest to `times` those in newtons."""
    return min(UNITS, key=lambda u: abs(np.log(times * TO_SI[u])))


def _ratio(x: float) -> float:
    """Return how far a factor is from 1, up or down."""
    return max(x, 1 / x)


def _factors(real: Array, force: Array) -> Array:
    """Return `(F,)` what fingertips read over the scene's forces, NaN where one does not tell, or most do not."""
    size = np.linalg.norm(real - tare(real, force), axis=-1)
    own = np.linalg.norm(force, axis=-1)
    touched = (own > TOUCH_N) & np.isfinite(size)
    both = touched & (size > ABOVE_NOISE * _noise(real, force))
    rows = both.sum((0, 1))
    telling = np.flatnonzero(rows >= TOUCH_ROWS)
    factors = np.full(len(rows), np.nan)
    if 2 * len(telling) > (touched.sum((0, 1)) >= TOUCH_ROWS).sum():
        factors[telling] = [np.median(size[..., f][both[..., f]] / own[..., f][both[..., f]]) for f in telling]
    return factors


def _noise_factor(scene: Scene, recs: Recordings, force: Array) -> float | None:
    """Return the noise of fingertips over the declared one, of free ones where there are; None where it does not tell.

    What is held from the start leaves none free: then the noise is at most what readings bend from row to row.
    """
    noise, real = scene.file.noise, recs.readings["fingertip_force"]
    spread = free_spread(real, force) or float(noise_sd(real, 1))
    if noise is None or not spread:
        return None
    # Rounding to steps of a width has a spread of width / sqrt(12) (Widrow and Kollar 2008, chapter 4).
    declared = float(np.hypot(noise.fingertip_force, noise.force_step / np.sqrt(12)))
    return spread / declared if declared > 0 else None


def _unit(times: float, unit: str) -> RecordingMismatch:
    """Return the finding that forces are in another unit."""
    name = f"{unit}: {1 / TO_SI[unit]:.4g}" if unit else "no known unit"
    mapped = f"give its unit in map.yaml: `units: {{fingertip_force: {unit}}}`, or " if unit else ""
    return RecordingMismatch(
        "force_unit",
        True,
        "fingertip_force is not in newton",
        "forces near the scene's in contact, N",
        f"{times:.3g} times those on all fingertips ({name})",
        f"{mapped}scale them to newtons",
        "fingertip_force",
    )


def _doubtful(times: float, why: str, kind: str = "force_unit") -> RecordingMismatch:
    """Return the note that forces may be in another unit."""
    return RecordingMismatch(
        kind,
        False,
        "fingertip_force may be in another unit",
        "forces near the scene's in contact, N",
        f"{times:.3g} times those on all fingertips ({why})",
        "if so, give its unit in map.yaml: `units: {fingertip_force: ...}`",
        "fingertip_force",
    )
