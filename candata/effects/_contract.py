"""What an effect is: named, bounded parameters and up to seven pure hooks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.scenes.assemble import Scene

Array = NDArray[np.float64]
Elements = Sequence[str | None]
Readings = dict[str, Array]


#: What other rooms ask of an effect. `simulator`: it changes how the simulation computes, not the world. `solver`: the
#: bench hides it as a mismatch of the solver. `one_for_all`: its one number for all joints is never just a little
#: wrong. `tracked_length`: it changes lengths or heights as a tracker reports them
#: (`gap/fit/length_scale.py` reads them off tosses). `contact_spring`: it is one of the two numbers of the spring
#: and damper of contacts, stiffness 1 / (timeconst dampratio)^2 and damping 2 / timeconst (MuJoCo manual, "solref").
#: `reading_noise`: a diagnosis counts what it does as noise of the sensor (`gap/data/noise.py`), so that it is never a
#: candidate of a search, and never drawn.
Trait = Literal["simulator", "solver", "one_for_all", "tracked_length", "contact_spring", "reading_noise"]

#: Units of joints that turn, to those of joints that slide.
RAILS = {"rad": "m", "rad/s": "m/s", "N m": "N", "N m/rad": "N/m", "N m s/rad": "N s/m", "kg m^2": "kg"}


class Bounds(NamedTuple):
    """Smallest and largest value that makes sense in a scene."""

    low: float
    high: float


@dataclass(frozen=True)
class Parameter:
    """One named number (or vector, or choice) of an effect.

    Attributes
    ----------
    name, unit : str
        Name with its unit, and the unit by `candata.units`.
    bounds : callable
        `scene -> Bounds`, the range that is searched.
    probes : callable
        `scene -> values` at which signatures are simulated, both sides of the identity where there are two.
    draws : callable
        `scene -> intervals` from which a hidden value is drawn: clearly there, still plausible.
    source : str
        Where the ranges come from.
    identity : callable
        `scene -> value` at which the effect vanishes; NaN where it replaces the model's own values.
    neutral : callable, optional
        `scene -> value` that comes closest to the model's own, where there is no identity.
    size : callable
        `scene -> int`, 1 for a scalar.
    choices : tuple of str
        The words of a discrete parameter; its number is the index.
    enumerated : bool
        Whether nothing lies between the probes: they are all the values there are.
    owners : callable, optional
        `scene -> names (size,)`: the element each number of a vector belongs to, where every element has its own.
    whole : callable, optional
        `scene -> names`: the owners whose numbers act where no element is named; all by default.
    rails : callable, optional
        `(scene, element) -> factor` by which its values are larger on an element that slides than on the fingers as a
        whole. Its unit is `RAILS[unit]` there.
    """

    name: str
    unit: str
    bounds: Callable[[Scene], Bounds]
    probes: Callable[[Scene], Sequence[float]]
    draws: Callable[[Scene], Sequence[tuple[float, float]]]
    source: str
    identity: Callable[[Scene], float] = lambda scene: float("nan")
    neutral: Callable[[Scene], float] | None = None
    size: Callable[[Scene], int] = lambda scene: 1
    choices: tuple[str, ...] = ()
    enumerated: bool = False
    owners: Callable[[Scene], tuple[str, ...]] | None = None
    whole: Callable[[Scene], tuple[str, ...]] | None = None
    rails: Callable[[Scene, str | None], float] | None = None

    def on_rails(self, factor: float) -> Parameter:
        """Return the parameter on joints that slide, its values `factor` times as large."""

        def rail_bounds(scene: Scene) -> Bounds:
            low, high = self.bounds(scene)
            return Bounds(factor * low, factor * high)

        neutral = self.neutral
        return replace(
            self,
            unit=RAILS[self.unit],
            bounds=rail_bounds,
            probes=lambda scene: tuple(factor * v for v in self.probes(scene)),
            draws=lambda scene: tuple((factor * a, factor * b) for a, b in self.draws(scene)),
            identity=lambda scene: factor * self.identity(scene),
            neutral=(lambda scene: factor * neutral(scene)) if neutral else None,
        )


class Forces(NamedTuple):
    """Forces that effects add to n simulations, and what the control step begins with.

    Attributes
    ----------
    added : (n, nv) float64
        Generalised forces [N, N m] held over the step: what a hook adds to.
    qpos, qvel : (n, nq), (n, nv) float64
        True state.
    effort : (n, nv) float64
        Generalised forces of the actuators in the last physics step [N, N m].
    tip_force : (n, F, 3) float64
        True forces on the fingertips over the step before [N].
    touch : (n,) bool
        Whether anything but the support touched the object in the step before.
    """

    added: Array
    qpos: Array
    qvel: Array
    effort: Array
    tip_force: Array
    touch: NDArray[np.bool_]


class Servos(NamedTuple):
    """Commands that the servos of n simulations take in one physics step.

    Attributes
    ----------
    command : (n, A) float64
        What the actuators are told, within their limits: what a hook replaces.
    idle : (n, A) float64
        Command at which each position law gives nothing where the joints are now: `command - idle` is the error that a
        servo sees, in units of its command. NaN for an actuator without such a law.
    """

    command: Array
    idle: Array


class DryFriction(NamedTuple):
    """Limits of the dry friction of n simulations, and what the control step begins with.

    Attributes
    ----------
    added : (n, nv) float64
        Limits [N, N m] over the step, beside the model's own `dof_frictionloss`: what a hook adds to.
    qvel : (n, nv) float64
        True velocities.
    effort : (n, nv) float64
        Generalised forces of the actuators in the last physics step [N, N m].
    """

    added: Array
    qvel: Array
    effort: Array


class DriveStrength(NamedTuple):
    """How strong the position servos of n simulations are over one control step, and what was recorded of their supply.

    Attributes
    ----------
    strength : (n, A) float64
        Factor on position gain and torque limit, 1 as the model has them: what a hook replaces.
    supply : (n, A) float64
        Recorded supply over its usual value; 1 where none was recorded.
    """

    strength: Array
    supply: Array


@dataclass(frozen=True)
class Hook:
    """A pure filter `(state, x) -> (state, x)`, vectorised over n simulations, once a control step.

    That of the servos acts once a physics step, and returns its state as it is: it has no memory.

    Attributes
    ----------
    start : callable
        `(scene, values (n, d), elements (n,)) -> state`.
    apply : callable
        `(state, x) -> (state, x)`. For commands x is `(n, S, A)`, S physics steps of one control step; for
        readings a dict of channel to `(n, ...)`; for forces x is a `Forces` and for friction a `DryFriction`, of which
        `added` may be replaced; for drives a `DriveStrength`, of which `strength` may be; for servos a `Servos`, of
        which `command` may be.
    """

    start: Callable[[Scene, Array, Elements], Any]
    apply: Callable[[Any, Any], tuple[Any, Any]]


@dataclass(frozen=True)
class Advice:
    """What to change in a simulator for an effect, in words.

    Attributes
    ----------
    change : str
        A sentence without its full stop. `{x}` is the value with its interval; `{joint}`, `{servo}`, `{link}`,
        `{tip}` and `{surface}` are what it acts on.
    mjcf : str
        How MJCF says it, `{raw}` the SI number; empty where MJCF has no attribute for it. Source of the attributes:
        MuJoCo manual, XML reference.
    """

    change: str
    mjcf: str = ""


@dataclass(frozen=True)
class Effect:
    """A small physical change of the simulated world.

    Attributes
    ----------
    about : str
        One line for people.
    parameters : tuple of Parameter
        Flattened in this order into the vector x of length d.
    acts_on : str
        joint, link, fingertip, object, wrist or world: what the report says when it names where.
    possible : callable
        `scene -> bool`: whether the effect can act there.
    edit : callable, optional
        `(model, scene, x (d,), element)` changes a private copy of the model.
    native : callable, optional
        `(model, scene, x (d,), element)` gives a copy of the model what MJCF holds in place of the hooks. An export
        writes it; candata does not simulate it. Raises SceneError where MJCF cannot hold it.
    set_const : bool
        Whether `mj_setConst` must follow the edit (masses, inertias, armature).
    command, force, friction, drive, servo, reading : Hook, optional
        Filters of the commands, of added forces, of limits of dry friction, of the strength of the servos, of what the
        servos take, of the readings.
    moves : tuple of str
        Channels that can change where there is a reading hook; empty without one.
    follows : tuple of str
        Recorded channels without which it changes nothing: a candidate only where they were recorded, and never drawn.
    elements : callable
        `scene -> names` of what it can act on alone (joints, fingertips, geoms); none where it has no elements.
    unread : callable, optional
        `(scene, x (d,), element, readings) -> readings` turns what was read at rest into what is true, `(..., D)` a
        channel: where a replay of a recording starts, and what it follows.
    on_time : callable, optional
        `(scene, x (d,), element, readings) -> readings` takes a delay off readings `(E, T, D)` a channel; NaN in the
        last rows, whose readings had not come yet.
    fitted : bool
        Whether its numbers only come from a fit to recordings: never a candidate of a search, never drawn.
    early : bool
        Whether its hooks act before those of other effects, which follow by name: a gain, before an offset is added.
    pace : callable, optional
        `(scene, x (d,)) -> float` true time that passes during one recorded control step, in control steps; the
        edit scales the physics step by the same.
    advice : Advice, optional
        What a report tells people to change; by default `about` and the value.
    traits : frozenset of str
        See `Trait`.
    """

    about: str
    parameters: tuple[Parameter, ...]
    acts_on: str
    possible: Callable[[Scene], bool]
    edit: Callable[[mujoco.MjModel, Scene, Array, str | None], None] | None = None
    native: Callable[[mujoco.MjModel, Scene, Array, str | None], None] | None = None
    set_const: bool = False
    command: Hook | None = None
    force: Hook | None = None
    friction: Hook | None = None
    drive: Hook | None = None
    servo: Hook | None = None
    reading: Hook | None = None
    moves: tuple[str, ...] = ()
    follows: tuple[str, ...] = ()
    elements: Callable[[Scene], tuple[str, ...]] = lambda scene: ()
    unread: Callable[[Scene, Array, str | None, Readings], Readings] | None = None
    on_time: Callable[[Scene, Array, str | None, Readings], Readings] | None = None
    pace: Callable[[Scene, Array], float] | None = None
    fitted: bool = False
    early: bool = False
    advice: Advice | None = None
    traits: frozenset[Trait] = frozenset()

    def __repr__(self) -> str:
        """Return what it does and its parameters in one line."""
        parameters = ", ".join(f"{parameter.name} [{parameter.unit}]" for parameter in self.parameters)
        return f"Effect({self.about!r}, {parameters})"

    def replaces(self, scene: Scene) -> bool:
        """Tell whether the effect puts its values in the place of the model's own: it has no identity."""
        return any(bool(np.isnan(p.identity(scene))) for p in self.parameters)


def constant_bounds(low: float, high: float) -> Callable[[Scene], Bounds]:
    """Return bounds that are the same in every scene."""
    return lambda scene: Bounds(low, high)


def spans(*intervals: tuple[float, float]) -> Callable[[Scene], Sequence[tuple[float, float]]]:
    """Return drawing intervals that are the same in every scene."""
    return lambda scene: intervals


def scaled_probes(reference: Callable[[Scene], float], *factors: float) -> Callable[[Scene], tuple[float, ...]]:
    """Return probes that are multiples of a quantity of the scene."""
    return lambda scene: tuple(f * reference(scene) for f in factors)


def scaled_bounds(reference: Callable[[Scene], float], low: float, high: float) -> Callable[[Scene], Bounds]:
    """Return bounds that are multiples of a quantity of the scene."""
    return lambda scene: Bounds(low * reference(scene), high * reference(scene))


def scaled_spans(
    reference: Callable[[Scene], float], *intervals: tuple[float, float]
) -> Callable[[Scene], Sequence[tuple[float, float]]]:
    """Return drawing intervals that are multiples of a quantity of the scene."""
    return lambda scene: tuple((a * reference(scene), b * reference(scene)) for a, b in intervals)


def values(*numbers: float) -> Callable[[Scene], Sequence[float]]:
    """Return probes that are the same in every scene."""
    return lambda scene: numbers


def always(number: float) -> Callable[[Scene], float]:
    """Return an identity that is the same in every scene."""
    return lambda scene: number
