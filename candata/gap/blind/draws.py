"""What a blind case hides: effects drawn from a secret number, kind by kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from candata.effects import Parameter, active, effect, effect_names, effects_with, parameters_on, setting
from candata.errors import UnknownNameError
from candata.gap.blind.outside_causes import CAUSES
from candata.scenes import Scene
from candata.schema.bench import Kind, Label, NoiseCase, OutsideCause
from candata.schema.effect import EffectSetting
from candata.simulate.seal import draw_parameter

Array = NDArray[np.float64]
#: Cases of each kind by default: what the targets ask for, within 90 minutes of two cores.
COUNTS: dict[Kind, int] = {
    "one": 120,
    "quarter": 40,
    "null": 100,
    "pair": 40,
    "triple": 40,
    "outside": 40,
    "background": 40,
    "solver": 40,
    "local": 40,
}
#: Relative error of everything in a background, 1 sd; of what the model lacks, as a share of a clear fault.
BACKGROUND = 0.05
#: Kinds of noise that take turns, by what is asked for.
NOISES: dict[str, tuple[NoiseCase, ...]] = {
    "declared": ("declared",),
    "misdeclared": ("misdeclared",),
    "undeclared": ("undeclared",),
    "mixed": ("declared", "misdeclared", "undeclared"),
}
#: True noise over declared noise where that is wrong, drawn evenly in its logarithm. Chosen: a data sheet, or a
#: measurement of another day, is seldom off by more than a factor of two.
MISDECLARED = (0.5, 2.0)
#: An object half as heavy again, on top of a solver mismatch.
HEAVY = 1.5


def possible_effects(scene: Scene, only: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the effects that can act in the scene, of those asked for."""
    names = only or effect_names()
    return tuple(name for name in names if effect(name).possible(scene))


def draw_labels(
    scene: Scene,
    counts: dict[Kind, int],
    rng: np.random.Generator,
    only: Sequence[str] = (),
    noise: str = "declared",
) -> list[Label]:
    """Return the labels of a run in random order; names take turns, so that each comes as often.

    Parameters
    ----------
    scene : Scene
        The nominal scene.
    counts : dict of Kind to int
        Cases of each kind.
    rng : numpy.random.Generator
        From the secret salt.
    only : sequence of str
        Effects to draw from; all that can act, when empty.
    noise : str
        One of `NOISES`: what the diagnosis is told of the sensors' noise; a mixture takes turns within each kind.
    """
    drawn = [label for kind, count in counts.items() for label in _of_kind(scene, kind, count, rng, only)]
    drawn = [_with_noise(label, NOISES[noise][i % len(NOISES[noise])], rng) for i, label in enumerate(drawn)]
    order = rng.permutation(len(drawn))
    return [
        drawn[k].model_copy(update={"case": f"case-{i + 1:04d}", "seed": int(rng.integers(2**62))})
        for i, k in enumerate(order)
    ]


def _of_kind(scene: Scene, kind: Kind, count: int, rng: np.random.Generator, only: Sequence[str]) -> list[Label]:
    """Return the labels of one kind."""
    pool = _POOLS.get(kind, possible_effects)(scene, only)
    if kind == "null":
        return [Label(case="", kind=kind)] * count
    return [_MAKERS[kind](scene, name, i, rng, pool) for i, name in enumerate(_turns(pool, count, rng))]


def _with_noise(label: Label, noise: NoiseCase, rng: np.random.Generator) -> Label:
    """Return a label with a kind of noise, its factor drawn where it is declared wrongly."""
    factor = float(np.exp(rng.uniform(*np.log(MISDECLARED)))) if noise == "misdeclared" else 1.0
    return label.model_copy(update={"noise": noise, "noise_factor": factor})


def _turns(names: Sequence[str], count: int, rng: np.random.Generator) -> list[str]:
    """Return `count` names, each as often as the others but for one, the order of each round random."""
    rounds = [rng.permutation(names) for _ in range(-(-count // len(names)))] if names else []
    return [str(name) for one in rounds for name in one][:count]


def draw_setting(scene: Scene, name: str, rng: np.random.Generator, element: str | None = None) -> EffectSetting:
    """Return an effect with values clearly away from the model's own, drawn as the effect's file says."""
    own, mine = neutral(name, scene), active(name, scene, element)
    found = parameters_on(name, scene, element)
    while True:
        x = np.concatenate([draw_parameter(p, scene, rng) for p in found])
        # Of a vector's farthest number, an element's own must be half as far at least.
        away = np.abs(x - np.nan_to_num(own))
        if element is None or len(x) == 1 or away[mine].max() >= 0.5 * _farthest(found, scene):
            return setting(name, x, scene, element)


def _farthest(found: Sequence[Parameter], scene: Scene) -> float:
    """Return how far from the identity a vector's number can be drawn."""
    return max(float(np.abs(np.array(p.draws(scene)) - np.nan_to_num(p.identity(scene))).max()) for p in found)


def neutral(name: str, scene: Scene) -> Array:
    """Return `(d,)` values at which an effect vanishes or comes closest to the model's own."""
    return np.concatenate([np.full(p.size(scene), _own(p, scene)) for p in effect(name).parameters])


def own_values(name: str, scene: Scene, element: str | None = None) -> dict[str, float]:
    """Return the model's own value of each parameter, of every number of a vector; NaN where there is none."""
    return {p.name: _own(p, scene) for p in parameters_on(name, scene, element)}


def _own(p: Parameter, scene: Scene) -> float:
    """Return the value of one parameter that is the model's own."""
    return p.neutral(scene) if p.neutral else p.identity(scene)


def weakened(scene: Scene, given: EffectSetting, part: float) -> EffectSetting:
    """Return an effect at a part of its distance from the identity; scales and times in their logarithm.

    What the model lacks, whose least value stands for none, has no scale: a part of it is a part of its value.
    """
    values = {}
    for p in parameters_on(given.name, scene, given.element):
        own, x = _own(p, scene), np.asarray(given.parameters[p.name], float)
        is_log = own > p.bounds(scene).low > 0
        near = own * (x / own) ** part if is_log else own + part * (x - own)
        values[p.name] = float(near) if near.ndim == 0 else tuple(float(v) for v in near)
    return given.model_copy(update={"parameters": values})


def continuous(scene: Scene, only: Sequence[str]) -> tuple[str, ...]:
    """Return the effects drawn from ranges: no choices, no fixed set of values."""
    names = possible_effects(scene, only)
    return tuple(n for n in names if all(high > low for p in effect(n).parameters for low, high in p.draws(scene)))


def localised(scene: Scene, only: Sequence[str]) -> tuple[str, ...]:
    """Return the effects that can be the fault of one element among several."""
    return tuple(n for n in possible_effects(scene, only) if len(effect(n).elements(scene)) > 1)


def background(scene: Scene, rng: np.random.Generator, spare: str) -> tuple[EffectSetting, ...]:
    """Return every parameter of joints, motors, object and contacts about 5 % wrong, except the effect `spare`.

    What scales or replaces a value of the model is off by a normal 5 % of it; what the model lacks is there with a
    normal 5 % of the smallest value a clear fault is drawn with.
    """
    found = []
    for name in continuous(scene, ()):
        kind = effect(name)
        if kind.edit is None or kind.reading or kind.acts_on == "world" or name == spare:
            continue
        # One limit for all joints is more than a little wrong where the model has several.
        if kind.traits & {"simulator", "one_for_all"}:
            continue
        x = np.concatenate([_off(p, scene, rng) for p in kind.parameters])
        found.append(setting(name, x, scene))
    return tuple(found)


def _off(p: Parameter, scene: Scene, rng: np.random.Generator) -> Array:
    """Return `(size,)` values of one parameter that are about 5 % wrong, within its bounds."""
    own, (low, high) = _own(p, scene), p.bounds(scene)
    shift = BACKGROUND * rng.standard_normal(p.size(scene))
    if own > max(low, 0.0):
        return np.clip(own * np.exp(shift), low, high)
    clear = float(np.abs(p.draws(scene)).min())
    return np.clip(np.abs(shift) * clear if low >= 0 else shift * clear, low, high)


def _one(scene: Scene, name: str, i: int, rng: np.random.Generator, pool: Sequence[str]) -> Label:
    return Label(case="", kind="one", effects=(draw_setting(scene, name, rng),))


def _quarter(scene: Scene, name: str, i: int, rng: np.random.Generator, pool: Sequence[str]) -> Label:
    return Label(case="", kind="quarter", effects=(weakened(scene, draw_setting(scene, name, rng), 0.25),))


def _local(scene: Scene, name: str, i: int, rng: np.random.Generator, pool: Sequence[str]) -> Label:
    element = str(rng.choice(effect(name).elements(scene)))
    return Label(case="", kind="local", effects=(draw_setting(scene, name, rng, element),))


def _several(kind: Kind, count: int) -> Callable[..., Label]:
    """Return the maker of sets of `count` distinct effects."""

    def make(scene: Scene, name: str, i: int, rng: np.random.Generator, pool: Sequence[str]) -> Label:
        others = [n for n in pool if n != name]
        names = [name, *map(str, rng.choice(others, count - 1, replace=False))]
        return Label(case="", kind=kind, effects=tuple(draw_setting(scene, n, rng) for n in names))

    return make


def _outside(scene: Scene, name: str, i: int, rng: np.random.Generator, pool: Sequence[str]) -> Label:
    return Label(case="", kind="outside", outside=draw_outside(name, scene, rng))


def _background(scene: Scene, name: str, i: int, rng: np.random.Generator, pool: Sequence[str]) -> Label:
    effects = (draw_setting(scene, name, rng), *background(scene, rng, name))
    return Label(case="", kind="background", effects=effects, main=name)


def _solver(scene: Scene, name: str, i: int, rng: np.random.Generator, pool: Sequence[str]) -> Label:
    """Return a solver mismatch; every other one has the wrong mass on top."""
    heavy = EffectSetting(name="object_mass", parameters={"mass_scale": HEAVY})
    on_top = (heavy,) if i % 2 and scene.object_id is not None else ()
    return Label(case="", kind="solver", effects=(draw_setting(scene, name, rng), *on_top))


def _solvers(scene: Scene, only: Sequence[str]) -> tuple[str, ...]:
    """Return the solver settings that a real world may have other: cone, integrator, time step, impratio."""
    return tuple(name for name in possible_effects(scene, only) if name in effects_with("solver"))


_POOLS: dict[Kind, Callable[[Scene, Sequence[str]], tuple[str, ...]]] = {
    "quarter": continuous,
    "local": localised,
    "outside": lambda scene, only: possible_outside(scene),
    "solver": _solvers,
}
_MAKERS: dict[Kind, Callable[..., Label]] = {
    "one": _one,
    "quarter": _quarter,
    "local": _local,
    "pair": _several("pair", 2),
    "triple": _several("triple", 3),
    "outside": _outside,
    "background": _background,
    "solver": _solver,
}


def possible_outside(scene: Scene) -> tuple[str, ...]:
    """Return the names of the outside causes that can act in the scene."""
    return tuple(name for name, cause in CAUSES.items() if cause.possible(scene))


def draw_outside(name: str, scene: Scene, rng: np.random.Generator) -> OutsideCause:
    """Return an outside cause with its place and its numbers.

    Raises
    ------
    UnknownNameError
        When there is none of that name.
    """
    if name not in CAUSES:
        raise UnknownNameError("outside cause", name, CAUSES)
    element, values = CAUSES[name].draw(scene, rng)
    return OutsideCause(name=name, acts_on=CAUSES[name].acts_on, element=element, values=values)
