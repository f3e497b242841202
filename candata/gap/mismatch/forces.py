"""Fingertip forces in another unit, or under another fingertip's name: told by the scene's own forces."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from candata.effects import effect
from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.mixed_units import ABOVE_NOISE, UNITS, mixed_findings
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.mismatch.sensors import TOUCH_N, TOUCH_ROWS, free_spread, tare
from candata.gap.mismatch.swaps import AT_LEAST, cycles, in_episodes, some_of
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
#: Rise of the mean cosine with the scene's forces by which an exchange of fingertips is told, and what it must reach:
#: in some 300 simulated worlds, each with other causes, no exchange gained anything in all episodes together; in some
#: episodes it did, and reached 0.53.
RISE, REACHED = 0.05, 0.6
#: What it must reach to be sure where only one episode asks, or others speak against it. (On a hand of two fingers
#: against one, whose joints were off by 5 deg, the two agreed better when exchanged in 3 of 12 episodes: 0.64.)
SURE = 0.8
#: Share of the largest squared force among exchanged fingertips that each must feel, recorded and simulated, to let an
#: episode ask: which of two opposed jaws bears a tilted object alone is chance. Chosen: 0.002 there at most.
SHARED = 0.005
#: Rows of touch that let an episode ask for an exchange.
ASKING_ROWS = 8


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


@dataclass(frozen=True)
class _Agreement:
    """How far recorded fingertips agree with the scene's, episode by episode.

    Attributes
    ----------
    dot : (E, F, F) float64
        Products of recorded (rows) and nominal forces, summed over time [N^2].
    own : (E, F, 3, 3) float64
        Products of the components of each recorded fingertip (rows) and of its own in the scene [N^2].
    real, nominal : (E, F) float64
        Squares of both.
    asking : (E, F) bool
        Where the scene touches long enough for an episode to ask for an exchange.
    """

    dot: Array
    own: Array
    real: Array
    nominal: Array
    asking: NDArray[np.bool_]

    def cosines(self, episodes: NDArray[np.bool_]) -> Array:
        """Return `(F, F)` the cosine of each recorded with each nominal fingertip, some episodes together."""
        size = self.real[episodes].sum(0)[:, None] * self.nominal[episodes].sum(0)
        return np.asarray(self.dot[episodes].sum(0) / np.sqrt(np.maximum(size, 1e-12)))

    def turned(self, episodes: NDArray[np.bool_]) -> Array:
        """Return `(F,)` each fingertip's cosine with its own when turned or mirrored at best (Kabsch 1976)."""
        size = self.real[episodes].sum(0) * self.nominal[episodes].sum(0)
        best = np.linalg.svd(self.own[episodes].sum(0), compute_uv=False).sum(-1)
        return np.asarray(best / np.sqrt(np.maximum(size, 1e-12)))


def exchange_findings(scene: Scene, recs: Recordings, force: Array) -> list[RecordingMismatch]:
    """Return fingertips that agree with each other's forces in the scene, and not with their own.

    Nothing where the scene's fingertips feel alike, or where another frame or sign explains as much.

    Parameters
    ----------
    force : (E, T, F, 3) float64
        Forces of a nominal replay [N].
    """
    if "fingertip_force" not in recs.readings or len(scene.file.fingertips) < 2:
        return []
    a = _agreement(recs.readings["fingertip_force"], force)
    for chosen in _exchanges(a):
        moved = np.flatnonzero(chosen != np.arange(len(chosen)))
        rise, signed = _rises(a, chosen, moved), _rises(a, chosen, moved, np.asarray)
        # Where some episodes agree as they are, a sign is no other convention.
        rise = signed if (signed < -RISE).any() else rise
        asked, against = rise > RISE, rise < -RISE
        if not asked.any() or (against.any() and asked.sum() < AT_LEAST):
            continue
        cosines = a.cosines(asked)
        before = float((cosines if against.any() else np.abs(cosines))[moved, moved].mean())
        after = float(cosines[moved, chosen[moved]].mean())
        # A frame that is turned is so in every episode.
        rival = 0.0 if against.any() else float(a.turned(asked)[moved].mean())
        if after > max(before + RISE, rival, REACHED):
            sure = after > SURE or (asked.sum() >= AT_LEAST and not against.any())
            return [_exchanged(scene, recs, chosen, asked, against, (before, after), sure)]
    return []


def _agreement(real: Array, force: Array) -> _Agreement:
    """Return how far recorded forces agree with the scene's, zero out of contact taken off the recorded ones."""
    own = np.where(np.isfinite(real), force, 0.0)
    seen = np.nan_to_num(real - tare(real, force))
    touched = (np.linalg.norm(own, axis=-1) > TOUCH_N).sum(1)
    return _Agreement(
        np.einsum("etic,etjc->eij", seen, own),
        np.einsum("etic,etid->eicd", seen, own),
        (seen**2).sum((1, 3)),
        (own**2).sum((1, 3)),
        touched >= ASKING_ROWS,
    )


def _exchanges(a: _Agreement) -> list[Index]:
    """Return exchanges `(F,)` worth a look: those that all episodes together ask for, and those that several do."""
    every = np.ones(len(a.dot), bool)
    each = [a.cosines(row) for row in np.eye(len(every), dtype=bool)]
    asked = Counter(c for e in each for c in _asked(e))
    often = [c for c, count in asked.most_common() if count >= AT_LEAST]
    found = [*_asked(a.cosines(every)), *often]
    return [np.array(c) for c in dict.fromkeys(found)]


def _asked(cosines: Array) -> list[tuple[int, ...]]:
    """Return the exchanges by which recorded fingertips agree with nominal ones better, one for each cycle."""
    _, chosen = linear_sum_assignment(-cosines + RISE * (1 - np.eye(len(cosines))))
    return [some_of(chosen, cycle) for cycle in cycles(chosen)]


def exchange_rivals(scene: Scene, recs: Recordings, force: Array) -> str:
    """Return which exchange of fingertips makes recorded forces agree with the scene's; nothing where none does."""
    if "fingertip_force" not in recs.readings or len(scene.file.fingertips) < 2:
        return ""
    a, tips = _agreement(recs.readings["fingertip_force"], force), scene.file.fingertips
    cosines = a.cosines(np.ones(len(a.dot), bool))
    for chosen in _exchanges(a):
        moved = np.flatnonzero(chosen != np.arange(len(chosen)))
        if cosines[moved, chosen[moved]].min() > SURE:
            return ", ".join(f"{tips[i]} reads what {tips[chosen[i]]} feels" for i in moved)
    return ""


def _rises(a: _Agreement, chosen: Index, moved: Index, own: Callable[[Array], Array] = np.abs) -> Array:
    """Return `(E,)` by how much the mean cosine rises with an exchange; 0 where an episode has no say.

    Parameters
    ----------
    own : callable
        What counts of a fingertip's cosine with its own: its size, unless a sign is no other convention.
    """
    out = np.zeros(len(a.dot))
    shared = np.logical_and(*(size[:, moved].min(1) > SHARED * size[:, moved].max(1) for size in (a.real, a.nominal)))
    for e in np.flatnonzero(a.asking[:, moved].all(1) & shared):
        cosines = a.cosines(np.arange(len(out)) == e)
        out[e] = (cosines[moved, chosen[moved]] - own(cosines[moved, moved])).mean()
    return out


def _exchanged(
    scene: Scene,
    recs: Recordings,
    chosen: Index,
    asked: NDArray[np.bool_],
    against: NDArray[np.bool_],
    cosines: tuple[float, float],
    sure: bool,
) -> RecordingMismatch:
    """Return the finding that fingertips are in another order, in all episodes or in those that ask for it."""
    tips = scene.file.fingertips
    moved = np.flatnonzero(chosen != np.arange(len(chosen)))
    pairs = ", ".join(f"{tips[i]} reads what {tips[chosen[i]]} feels" for i in moved)
    where = in_episodes(recs, asked) if against.any() else "in all episodes"
    order = "put the columns of `fingertip_force` in the order of `fingertips` in scene.yaml, or name them"
    verb = "are" if sure else "may be"
    return RecordingMismatch(
        "swapped_fingertips",
        sure,
        f"forces {verb} in another order than the scene's fingertips",
        "each fingertip agrees with its own in the scene",
        f"{pairs}, {where} (cosine {cosines[1]:.2f}, as given {cosines[0]:.2f})",
        f"{order}, the same in every episode" if against.any() else order,
        "fingertip_force",
        tuple(tips[i] for i in moved),
    )
