"""Where a residual force acts: every joint, the object, every fingertip, each with the few terms that describe it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.effects._residual_terms import AXES, JOINT_TERMS, OBJECT_TERMS
from candata.gap.force.dictionary import Description, Sample, alternatives, describe_force, fitted
from candata.gap.force.residual_force import Residual
from candata.gap.measure.symptoms import slides
from candata.scenes import Scene

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Place = Literal["joint", "fingertip", "object", "wrist"]
#: Length of the means that are regressed [s]: motion is slower, the noise of differentiated readings averages out.
BLOCK_S = 0.1
#: Terms of a fingertip's reading.
TIP_TERMS: tuple[tuple[str, ...], ...] = (
    ("constant",),
    ("load",),
    ("sign of load change", "load"),
    ("time",),
    ("memory", "load"),
)
#: Change of a reading over which its direction is known [N].
TURN_N = 0.3
#: Time in which a fingertip's memory of its load fades [s]. Chosen: between the lag of a sensor and a grasp.
CREEP_S = 1.0
#: Wave numbers that are tried for a force that repeats with position [rad per rad], as many per travel of a slide.
WAVES = np.arange(2.0, 61.0, 0.5)
#: Means over which waves are sought, in parts of a block.
FINER = 4
#: Index of the first of the two periodic terms.
_PERIODIC = len(JOINT_TERMS) - 2


@dataclass(frozen=True)
class Suspect:
    """An element, the sample of its residual force and the terms that describe it.

    Attributes
    ----------
    place : str
        joint, wrist, object or fingertip.
    element : str
        A joint, a fingertip, or `object`.
    axes : slice
        Which of the object's six forces; empty otherwise.
    sample : Sample
        Block means.
    by_row : (E, T, A, K) float64
        The terms of every row in which a force could show; NaN in others.
    description : Description
    wave : float
        Wave number of the periodic terms.
    names : tuple of tuples of str
        What each term depends on.
    """

    place: Place
    element: str
    axes: slice
    sample: Sample
    by_row: Array
    description: Description
    wave: float
    names: tuple[tuple[str, ...], ...]

    @property
    def gain(self) -> float:
        """Held-out gain."""
        return float(self.description.gain.sum())

    @property
    def depends_on(self) -> tuple[str, ...]:
        """What the force depends on, the most telling first."""
        return tuple(
            dict.fromkeys(name.replace("periodic ", "") for k in self.description.terms for name in self.names[k])
        )


def suspects(scene: Scene, real: Residual, null: Residual, parts: Sequence[Index]) -> list[Suspect]:
    """Return every element with the description of its residual force, the largest held-out gain first.

    Parameters
    ----------
    scene : Scene
    real, null : Residual
        Of the recordings, and of null replays of the same commands.
    parts : sequence of index arrays
        Folds of the episodes.
    """
    found = [_joint(scene, j, real, null, parts) for j in range(len(scene.joint_ids))]
    if scene.object_id is not None:
        found += [_object(scene, axes, real, null, parts) for axes in (slice(0, 3), slice(3, AXES))]
    found += [_tip(scene, tip, real, null, parts) for tip in range(real.tip.shape[2])]
    return sorted(found, key=lambda s: -s.gain)


def otherwise(suspect: Suspect, parts: Sequence[Index]) -> list[Suspect]:
    """Return a suspect with other plain descriptions that held-out episodes do not tell from the best, best first."""
    return [replace(suspect, description=d) for d in alternatives(suspect.sample, parts, suspect.description.terms)]


def pulls(scene: Scene, suspect: Suspect) -> list[Suspect]:
    """Return pulls of the support, as large as the object's weight where it rests, over each height they fade in.

    No residual force tells of these: the support takes what pulls the object onto it. They are made from the `suspect`,
    a force on the object; none where that is another, or nothing carries the object.
    """
    if suspect.place != "object" or suspect.axes.start > 0 or scene.file.support is None:
        return []
    weight = float(scene.model.body_subtreemass[scene.object_id] * np.linalg.norm(scene.model.opt.gravity))
    down, out = np.array([0.0, 0.0, -weight]), []
    for k, name in enumerate(OBJECT_TERMS):
        if name == ("nearness to the support",):
            sample = replace(suspect.sample, force=suspect.sample.terms[..., k] * down)
            out.append(
                replace(suspect, sample=sample, description=Description((k,), down[None], suspect.description.gain))
            )
    return out


def _joint(scene: Scene, j: int, real: Residual, null: Residual, parts: Sequence[Index]) -> Suspect:
    """Return the suspicion on one joint."""
    rows = _rows(scene)
    pair = [
        Sample(_blocks(r.force[:, :, j : j + 1], rows), _blocks(r.joint[:, :, j], rows)[:, :, None], (), np.ones(1))
        for r in (real, null)
    ]
    plain = [(k,) for k in range(_PERIODIC)]
    sample = _against(pair[0], pair[1], plain)
    wave = _best_wave(real.force[:, :, j], real.position[:, :, j], max(1, rows // FINER), _travel(scene, j))
    at = wave * real.position[:, :, j, None]
    by_row = np.concatenate([real.joint[:, :, j, :_PERIODIC], np.sin(at), np.cos(at)], axis=-1)[:, :, None]
    terms = np.concatenate([sample.terms[..., :_PERIODIC], _blocks(by_row[..., _PERIODIC:], rows)], axis=-1)
    sample = replace(sample, terms=terms, groups=(*plain, (_PERIODIC, _PERIODIC + 1)))
    place: Place = "wrist" if scene.file.joints[j] in slides(scene) else "joint"
    found = describe_force(sample, parts)
    return Suspect(place, scene.file.joints[j], slice(0), sample, by_row, found, wave, JOINT_TERMS)


def _object(scene: Scene, axes: slice, real: Residual, null: Residual, parts: Sequence[Index]) -> Suspect:
    """Return the suspicion on the object: a force (axes 0 to 3) or a torque (3 to 6)."""
    rows, first = _rows(scene), len(scene.joint_ids)
    wanted = slice(first + axes.start, first + axes.stop)
    pair = []
    for r in (real, null):
        force = np.where(_free(scene, r)[:, :, None], r.force[:, :, wanted], np.nan)
        if axes.start == 0:
            # The support takes what pulls the object onto it, and pushes with what it is spared.
            force[..., 2] = np.where(_of_object(r, "off the support"), force[..., 2], np.nan)
        terms = np.moveaxis(r.object[..., axes], 2, 3)
        pair.append(Sample(_blocks(force, rows), _blocks(terms, rows), (), np.ones(axes.stop - axes.start)))
    sample = _against(pair[0], pair[1], [(k,) for k in range(len(OBJECT_TERMS))])
    by_row = np.where(_free(scene, real)[:, :, None, None], np.moveaxis(real.object[..., axes], 2, 3), np.nan)
    return Suspect("object", "object", axes, sample, by_row, describe_force(sample, parts), 1.0, OBJECT_TERMS)


def _free(scene: Scene, r: Residual) -> NDArray[np.bool_]:
    """Return `(E, T)` whether a force on the object could show: it is touched or off its support.

    An untouched object that rests on its support stays where it is whatever pulls it, up to dry friction.
    """
    return _of_object(r, "off the support") | _of_object(r, "in contact")


def _of_object(r: Residual, circumstance: str) -> NDArray[np.bool_]:
    """Return `(E, T)` whether a circumstance of the object holds."""
    return np.asarray(r.object[:, :, OBJECT_TERMS.index((circumstance,)), 0] > 0)


def _tip(scene: Scene, tip: int, real: Residual, null: Residual, parts: Sequence[Index]) -> Suspect:
    """Return the suspicion on what one fingertip reads."""
    rows = _rows(scene)
    pair = [
        Sample(_blocks(r.tip[:, :, tip], rows), _blocks(tip_terms(scene, r.felt[:, :, tip]), rows), (), np.ones(3))
        for r in (real, null)
    ]
    sample = _against(pair[0], pair[1], [(k,) for k in range(len(TIP_TERMS))])
    name = scene.file.fingertips[tip]
    by_row = tip_terms(scene, real.felt[:, :, tip])
    return Suspect("fingertip", name, slice(0), sample, by_row, describe_force(sample, parts), 1.0, TIP_TERMS)


def tip_terms(scene: Scene, felt: Array) -> Array:
    """Return `(E, T, 3, 5)` the terms of a reading, from the forces `(E, T, 3)` that the fingertip truly feels [N]."""
    turn, memory = np.zeros_like(felt), np.zeros_like(felt)
    fade = 1 / (CREEP_S * scene.file.rate_hz)
    for row in range(1, felt.shape[1]):
        turn[:, row] = np.clip(turn[:, row - 1] + (felt[:, row] - felt[:, row - 1]) / TURN_N, -1, 1)
        memory[:, row] = memory[:, row - 1] + fade * (felt[:, row] - memory[:, row - 1])
    time = np.broadcast_to((np.arange(felt.shape[1]) / scene.file.rate_hz)[None, :, None], felt.shape)
    return np.stack([np.ones_like(felt), felt, turn * np.abs(felt), time, memory], axis=-1)


def _against(real: Sample, null: Sample, groups: Sequence[tuple[int, ...]]) -> Sample:
    """Return the sample less what the method itself shows in null replays, in units of their spread."""
    everything = tuple(k for group in groups for k in group)
    first = replace(null, sigma=_spread(null.force))
    bias = fitted(first, everything)
    left = [s.force - np.einsum("ebak,ka->eba", s.terms[..., list(everything)], bias) for s in (real, null)]
    return replace(real, force=left[0], groups=tuple(groups), sigma=_spread(left[1], len(everything)))


def _spread(force: Array, fitted_terms: int = 0) -> Array:
    """Return `(A,)` the 68 % quantile of the sizes; 1 where there are no more of them than terms were fitted."""
    flat = np.abs(force).reshape(-1, force.shape[-1])
    out = np.ones(flat.shape[1])
    for a in range(flat.shape[1]):
        seen = flat[np.isfinite(flat[:, a]), a]
        if len(seen) > fitted_terms:
            out[a] = max(float(np.quantile(seen, 0.68)), 1e-9)
    return out


def _best_wave(force: Array, position: Array, rows: int, travel: float) -> float:
    """Return the wave number with which a force that repeats with position removes most, outliers held at two spreads.

    Means over few rows: a fast joint passes several waves in a block.
    """
    y, q = (_blocks(values, rows).ravel() for values in (force, position))
    seen = np.isfinite(y)
    if seen.sum() <= 3:
        return 1.0
    limit = 2 * np.quantile(np.abs(y[seen]), 0.68)
    y, q = np.clip(y[seen], -limit, limit), q[seen]
    numbers = WAVES / travel
    return float(numbers[np.argmin([_left(number, q, y) for number in numbers])])


def _left(number: float, q: Array, y: Array) -> float:
    """Return the squares that a wave and a constant leave of `y (n,)` at positions `q (n,)`."""
    design = np.stack([np.sin(number * q), np.cos(number * q), np.ones_like(q)], axis=1)
    square = design.T @ design + 1e-9 * np.eye(3) * len(q)
    product = design.T @ y
    return float(y @ y - product @ np.linalg.solve(square, product))


def _travel(scene: Scene, j: int) -> float:
    """Return what the wave numbers of a joint are counted on: a radian, or the travel of a slide [m]."""
    joint = int(scene.joint_ids[j])
    if scene.model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_SLIDE:
        return 1.0
    low, high = scene.model.jnt_range[joint]
    return float(high - low) if high > low else 1.0


def _rows(scene: Scene) -> int:
    """Return the rows of a block."""
    return max(1, round(BLOCK_S * scene.file.rate_hz))


def _blocks(values: Array, rows: int) -> Array:
    """Return `(E, B, ...)` means over blocks; NaN where a row is missing."""
    count = values.shape[1] // rows
    return values[:, : count * rows].reshape(len(values), count, rows, *values.shape[2:]).mean(2)
