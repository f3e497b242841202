"""Parameters of effects as places in a model: number = offset + slope x value."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.effects import active, effect, flatten, parameters_on, setting
from candata.repair.fields import DIRECT_FIELDS, OPTIONS, differences, joint_of, read
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.schema.record import ResultRecord
from candata.simulate.world import build_worlds

Array = NDArray[np.float64]
#: Whole numbers of a model, which no fit moves.
WHOLE_NUMBERS = ("geom_condim", "geom_priority", "pair_dim")
#: Model array -> (kind of spec element, attribute) of what a parameter of the toolbox can write.
SPEC = {array: place for array, place in DIRECT_FIELDS.items() if array not in WHOLE_NUMBERS} | {
    "geom_size": ("geom", "size"),
    "geom_pos": ("geom", "pos"),
    "actuator_gainprm": ("actuator", "gainprm"),
    "actuator_biasprm": ("actuator", "biasprm"),
    "body_mass": ("body", "mass"),
    "body_inertia": ("body", "inertia"),
    "body_ipos": ("body", "ipos"),
}
#: Attributes of which the model's array is the first number only: damping may grow with speed, stiffness with the turn.
FIRST_NUMBER_ONLY = ("damping", "stiffness")
#: How far from a straight line still counts as one, of the largest change.
STRAIGHT = 1e-9


class ParameterTarget(ResultRecord):
    """One number of a model that a parameter sets; `index` null where the attribute is one number."""

    kind: str
    name: str
    attribute: str
    index: int | None
    offset: float
    slope: float


class FreeParameter(ResultRecord):
    """One parameter with bounds and start; `places` for each of its components."""

    name: str
    effect: str
    parameter: str
    unit: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    start: tuple[float, ...]
    own: tuple[float, ...]
    places: tuple[tuple[ParameterTarget, ...], ...]


def free_parameters(
    scene: Scene, effects: Sequence[EffectSetting], effect_number: int, names: mujoco.MjModel
) -> list[FreeParameter]:
    """Return the parameters of one of the effects, the others kept; none where it does not act along straight lines.

    Parameters
    ----------
    scene : Scene
    effects : sequence of EffectSetting
        All effects, at their start values.
    effect_number : int
        Index of the one asked for.
    names : mujoco.MjModel
        A model of the same elements in which each that matters has a name.
    """
    s = effects[effect_number]
    kind, x = effect(s.name), flatten(s, scene)
    if any(p.choices for p in kind.parameters):
        return []
    is_active, out, offset = active(s.name, scene, s.element), [], 0
    for p in parameters_on(s.name, scene, s.element):
        ids = np.flatnonzero(is_active[offset : offset + p.size(scene)]) + offset
        offset += p.size(scene)
        low, high = p.bounds(scene)
        places = [_places(scene, effects, effect_number, x, int(i), (low, high), names) for i in ids]
        if not all(places):
            return []
        neutral = p.identity(scene) if p.neutral is None else p.neutral(scene)
        label = f"{s.name}.{s.element}.{p.name}" if s.element else f"{s.name}.{p.name}"
        width = len(ids)
        out.append(
            FreeParameter(
                name=label,
                effect=s.name,
                parameter=p.name,
                unit=p.unit,
                low=(low,) * width,
                high=(high,) * width,
                start=tuple(x[ids].tolist()),
                own=(float(neutral),) * width,
                places=tuple(tuple(component_places or ()) for component_places in places),
            )
        )
    return out


def _places(
    scene: Scene,
    effects: Sequence[EffectSetting],
    effect_number: int,
    x: Array,
    component: int,
    bounds: tuple[float, float],
    names: mujoco.MjModel,
) -> list[ParameterTarget] | None:
    """Return what one component moves; None where that is not a straight line, or nothing that can be written."""
    s = effects[effect_number]
    models, values = [], [bounds[0] + share * (bounds[1] - bounds[0]) for share in (0.25, 0.5, 0.8)]
    for value in values:
        at = x.copy()
        at[component] = value
        settings = [*effects[:effect_number], setting(s.name, at, scene, s.element), *effects[effect_number + 1 :]]
        models.append(build_worlds(scene, [settings]).models[0])
    out: list[ParameterTarget] = []
    for d in differences(models[0], models[2]):
        numbers = [read(m, d.field) for m in models]
        slope = (numbers[2] - numbers[0]) / (values[2] - values[0])
        deviation = np.abs(numbers[0] + slope * (values[1] - values[0]) - numbers[1])
        is_writable = d.field in SPEC or d.field in OPTIONS
        if not is_writable or deviation.max() > STRAIGHT * np.abs(numbers[2] - numbers[0]).max():
            return None
        offset = numbers[0] - slope * values[0]
        out += [_place(names, d.field, int(i), int(j), offset, slope) for i, j in np.argwhere(slope != 0)]
    return out or None


def _place(names: mujoco.MjModel, field: str, row: int, column: int, offset: Array, slope: Array) -> ParameterTarget:
    """Return one number of a model by the name of its element."""
    numbers = {"offset": float(offset[row, column]), "slope": float(slope[row, column])}
    is_vector = offset.shape[1] > 1
    if field in OPTIONS:
        return ParameterTarget(kind="option", name="", attribute=field, index=column if is_vector else None, **numbers)
    kind, attribute = SPEC[field]
    if kind == "joint":
        row = joint_of(names, field, row)
    element = getattr(names, kind)(row)
    index = column if is_vector or attribute in FIRST_NUMBER_ONLY else None
    return ParameterTarget(kind=kind, name=element.name, attribute=attribute, index=index, **numbers)
