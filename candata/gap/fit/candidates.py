"""Candidates: effects that can act in a scene, with the probes at which they are simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.effects import (
    Bounds,
    Parameter,
    active,
    effect,
    effect_names,
    members_of,
    parameters_on,
    setting,
    together_on,
)
from candata.scenes import Scene
from candata.schema.effect import EffectSetting

Array = NDArray[np.float64]
#: How far the end of what is plausible must lie beyond the probes to be probed too, as a share of what is plausible.
BEYOND = 0.1
#: How many times the neutral value the nearest probe of a scale or time may be before one halfway is added. Chosen: a
#: probe at half or double is near enough; only limits and some contact parameters are probed no nearer than that.
FAR = 2.1
#: Numbers of a vector up to which a first look reads both signs of each: across both, signatures say more of a place
#: beyond them. Record 43.
FEW_NUMBERS = 3


@dataclass(frozen=True)
class Candidate:
    """One effect (or one element of it) as a vector of coordinates.

    Attributes
    ----------
    name, element : str
        Which effect, where (None: everywhere it acts).
    neutral : (d,) float64
        Coordinates at which it vanishes, or comes closest to the model's own.
    low, high : (d,) float64
        Bounds of the coordinates.
    logarithmic : (d,) bool
        Coordinates that are logarithms of the value (scales and times), so that half and double are alike.
    choices : bool
        Whether only the probes and the neutral value exist: words, or numbers with nothing between them.
    own : (n,) bool
        Which of the effect's n numbers the coordinates are; the others stay at their identity.
    rest : (n,) float64
        The effect's numbers at their identity.
    """

    name: str
    element: str | None
    neutral: Array
    low: Array
    high: Array
    logarithmic: NDArray[np.bool_]
    choices: bool
    own: NDArray[np.bool_]
    rest: Array

    @property
    def size(self) -> int:
        """Number of coordinates d."""
        return len(self.neutral)

    @property
    def is_ordered(self) -> bool:
        """Whether it is a choice among values that have an order, as a time step."""
        return effect(self.name).parameters[0].enumerated

    def is_neutral(self, u: Array) -> bool:
        """Tell whether `u (d,)` is the absence of the effect."""
        return bool(np.allclose(u, self.neutral, atol=1e-9))

    @property
    def label(self) -> str:
        """Name, with the element where there is one."""
        return self.name if self.element is None else f"{self.name} {self.element}"

    def values(self, u: Array) -> Array:
        """Return parameter values of coordinates `u (d,)`, inside the bounds."""
        inside = np.clip(u, self.low, self.high)
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, inside, 0.0)), inside)

    def setting(self, u: Array, scene: Scene) -> EffectSetting:
        """Return the effect setting at coordinates `u (d,)`."""
        x = self.rest.copy()
        x[self.own] = self.values(u)
        return setting(self.name, x, scene, self.element)


def candidate(name: str, scene: Scene, element: str | None = None) -> Candidate:
    """Return the candidate for one effect in a scene, everywhere or on one element."""
    rows: list[tuple[float, float, float, float, bool]] = []
    for p in parameters_on(name, scene, element):
        own = p.neutral(scene) if p.neutral else p.identity(scene)
        bounds = _bounds(p, scene, own)
        is_log = not p.choices and bounds.low > 0 and own > 0
        low, high, at = np.log([bounds.low, bounds.high, own]) if is_log else (bounds.low, bounds.high, own)
        rows += [(at, low, high, own, is_log)] * p.size(scene)
    table = np.array(rows, float)
    mine = active(name, scene, element)
    neutral, low_end, high_end = table[mine, :3].T.copy()
    first = effect(name).parameters[0]
    discrete = bool(first.choices) or first.enumerated
    return Candidate(
        name, element, neutral, low_end, high_end, table[mine, 4].astype(bool), discrete, mine, table[:, 3].copy()
    )


def _bounds(parameter: Parameter, scene: Scene, neutral: float) -> Bounds:
    """Return the bounds of a parameter, such that a file of the scene's own effects and of this one can be read.

    Values of a file are judged by the scene without its given effects.
    """
    low, high = parameter.bounds(scene)
    if scene.plain is not None:
        plain = parameter.bounds(scene.plain)
        low, high = max(low, plain.low), min(high, plain.high)
    return Bounds(min(low, neutral), max(high, neutral))


def candidates(scene: Scene, channels: Sequence[str]) -> list[Candidate]:
    """Return every effect of the folder that can act in the scene and shows in, or follows, the recorded channels."""
    found = []
    for name in effect_names(channels):
        kind = effect(name)
        if not kind.possible(scene) or (kind.moves and not set(kind.moves) & set(channels)):
            continue
        found.append(candidate(name, scene))
    return found


def local_candidates(c: Candidate, scene: Scene) -> list[Candidate]:
    """Return the variants of a candidate that act on one joint, fingertip or geom alone.

    Not a lone element that the candidate touches anyway.
    """
    if c.element is not None:
        return []
    found = [candidate(c.name, scene, e) for e in effect(c.name).elements(scene)]
    return found if len(found) > 1 else [v for v in found if is_on_slides(v, scene)]


def on_slides(c: Candidate, scene: Scene) -> list[Candidate]:
    """Return the variants of a candidate on groups of joints where it does not act as a whole: on slides."""
    return [v for v in local_candidates(c, scene) if is_on_slides(v, scene)]


def is_on_slides(c: Candidate, scene: Scene) -> bool:
    """Tell whether a candidate acts on joints that its effect as a whole spares: slides beside hinges."""
    if c.element is None or effect(c.name).acts_on != "joint" or not len(scene.driven_hinges):
        return False
    whole = {scene.file.joints[i] for i in together_on(c.name, scene)}
    return not whole.issuperset(elements_of(c, scene))


def elements_of(c: Candidate, scene: Scene) -> tuple[str, ...]:
    """Return the joints or links of a candidate on a group, or all fingertips; else its element alone."""
    return members_of(c.name, scene, str(c.element))


def probes(c: Candidate, scene: Scene) -> list[Array]:
    """Return the coordinates `(d,)` of a candidate's probes, along one coordinate each.

    A scalar is also probed at the ends of what is plausible, where those lie beyond its probes, and halfway to the
    nearest of them, where that is far: a limit acts near its neutral value at other times than farther out. A single
    number of a vector takes both signs of its probes, where its bounds do. What lies beyond bounds counts as on them.
    """
    numbers = [
        np.array(p.probes(scene), float) for p in parameters_on(c.name, scene, c.element) for _ in range(p.size(scene))
    ]
    mine = [n for n, own in zip(numbers, c.own, strict=True) if own]
    if c.size == 1 and len(c.own) > 1 and c.low[0] < 0 < c.high[0]:
        mine = [np.unique(np.concatenate([-n, n])) for n in mine]
    if c.size == 1 and not c.choices:
        mine = [np.unique(np.concatenate([mine[0], _plausible_ends(c, scene, mine[0]), _halfway(c, mine[0])]))]
    out = []
    for column, values in enumerate(mine):
        inside = np.clip(np.log(values) if c.logarithmic[column] else values, c.low[column], c.high[column])
        for value in dict.fromkeys(inside.tolist()):
            point = c.neutral.copy()
            point[column] = value
            if not c.is_neutral(point):
                out.append(point)
    return out


def _plausible_ends(c: Candidate, scene: Scene, known: Array) -> Array:
    """Return the smallest and the largest value worth drawing, where they lie clearly beyond the known probes."""
    found = parameters_on(c.name, scene, c.element)
    (parameter,) = [p for p in found if p.size(scene) == len(c.own)] or found[:1]
    ends = np.array(parameter.draws(scene), float)
    low, high = float(ends.min()), float(ends.max())
    beyond = [v for v, far in ((low, known.min() - low), (high, high - known.max())) if far > BEYOND * (high - low)]
    inside = np.exp([c.low[0], c.high[0]]) if c.logarithmic[0] else (c.low[0], c.high[0])
    return np.clip(beyond, *inside)


def _halfway(c: Candidate, known: Array) -> Array:
    """Return the values between a logarithmic coordinate's neutral one and its nearest probes, where those are far."""
    if not c.logarithmic[0]:
        return np.zeros(0)
    own = float(np.exp(c.neutral[0]))
    known = np.sort(known)
    nearest = [*known[known < own][-1:], *known[known > own][:1]]
    return np.array([np.sqrt(own * v) for v in nearest if max(v / own, own / v) > FAR])


def typical_size(c: Candidate, scene: Scene) -> Array:
    """Return `(d,)` how far from neutral a plausible effect of this kind lies, between a faint and a strong one."""
    found = parameters_on(c.name, scene, c.element)
    ends = [np.array(p.draws(scene), float) for p in found for _ in range(p.size(scene))]
    mine = [e for e, own in zip(ends, c.own, strict=True) if own]
    rows = zip(mine, c.logarithmic, c.neutral, strict=True)
    away = [np.abs((np.log(e) if log else e) - at) for e, log, at in rows]
    return np.array([(far.min() + far.max()) / 2 for far in away])


def first_probes(c: Candidate, scene: Scene) -> list[Array]:
    """Return the probes of a first look: of a scalar three of each side at most, of many numbers one of each.

    Of four or more on a side, the middle and the farthest, and of an effect that acts everywhere the nearest too: what
    sets in at a limit, as of a motor's torque, does near the neutral value what it does not do farther out.
    """
    points = probes(c, scene)
    if c.choices or 1 < c.size <= FEW_NUMBERS:
        return points
    if c.size > 1:
        return list({int(np.flatnonzero(p != c.neutral)[0]): p for p in points}.values())
    below = sorted((p for p in points if p[0] < c.neutral[0]), key=lambda p: -p[0])
    above = sorted((p for p in points if p[0] >= c.neutral[0]), key=lambda p: p[0])
    found = [side[i] for side in (below, above) for i in _first(len(side), c.element is None)]
    return sorted(found, key=lambda p: float(p[0]))


def _first(count: int, nearest: bool) -> tuple[int, ...]:
    """Return which of the probes of one side, nearest first, are looked at first; of many, `nearest` too."""
    if count <= 3:
        return tuple(range(count))
    return ((0,) if nearest else ()) + ((count - 1) // 2, count - 1)


def widespread(c: Candidate, u: Array, scene: Scene) -> tuple[Candidate, Array]:
    """Return the effect of which `c` is the variant on one element, as strong there; other numbers are neutral."""
    whole = candidate(c.name, scene)
    at = whole.neutral.copy()
    at[c.own[whole.own]] = u
    return whole, at
