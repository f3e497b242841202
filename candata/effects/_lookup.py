"""Effects by name, and the way between settings (names) and vectors (numbers)."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from candata.effects import _contact, _links, _select
from candata.effects._contract import Array, Effect, Parameter, Trait
from candata.errors import UnknownNameError, UsageError
from candata.plugins import Registry
from candata.scenes.assemble import Scene
from candata.schema.effect import EffectSetting, Value

EFFECTS = Registry("effects", "candata.effects", "EFFECT", Effect, "about")


def effect_names(recorded: Collection[str] = ()) -> tuple[str, ...]:
    """Return the names of all effects that are searched and drawn: all but those only fitted, or noise of a sensor.

    Those that follow recorded channels only where all of these are among `recorded`.
    """
    return tuple(
        name
        for name, kind in EFFECTS.load_all().items()
        if not kind.fitted and "reading_noise" not in kind.traits and set(kind.follows) <= set(recorded)
    )


def effects_with(trait: Trait) -> tuple[str, ...]:
    """Return the names of all effects that have a trait, sorted."""
    return tuple(name for name, kind in EFFECTS.load_all().items() if trait in kind.traits)


def effect(name: str) -> Effect:
    """Return the effect called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    PluginError
        When it comes from another package and cannot be used.
    """
    return EFFECTS.load(name)


def parameters_on(name: str, scene: Scene, element: str | None = None) -> tuple[Parameter, ...]:
    """Return an effect's parameters with the ranges that they have on an element: in m and N where that slides.

    Raises
    ------
    UnknownNameError
        When there is no such effect, or the effect no such element.
    """
    return tuple(
        p.on_rails(p.rails(scene, element)) if p.rails and _select.on_rails(scene, element) else p
        for p in effect(name).parameters
    )


def together_on(name: str, scene: Scene) -> NDArray[np.int64]:
    """Return indices into `scene.file.joints` of the joints on which an effect of joints or drives acts as a whole."""
    has_rail_values = any(p.rails for p in effect(name).parameters)
    return _select.fingers(scene) if has_rail_values else _select.shared_joints(scene)


def members_of(name: str, scene: Scene, element: str) -> tuple[str, ...]:
    """Return the joints or links of a group, or the fingertips where an element is all of them; else it alone."""
    if effect(name).acts_on == "link":
        return _links.members(scene, element)
    if effect(name).acts_on == "joint":
        return scene.file.groups.get(element, (element,))
    return _contact.members(scene, element)


def sensed_at(name: str, scene: Scene, element: str) -> tuple[str, ...]:
    """Return the joints or fingertips whose readings show an element first: its members, or the joints of a link.

    Raises
    ------
    UnknownNameError
        When the effect acts on links, and the element is none.
    """
    if effect(name).acts_on == "link":
        return _links.joints_of(scene, element)
    return members_of(name, scene, element)


def rail_units(name: str, scene: Scene, element: str | None = None) -> dict[str, str]:
    """Return the units of an effect's parameters that are others than their names say, on joints that slide."""
    pairs = zip(effect(name).parameters, parameters_on(name, scene, element), strict=True)
    return {p.name: rail_parameter.unit for p, rail_parameter in pairs if rail_parameter.unit != p.unit}


def flatten(setting: EffectSetting, scene: Scene) -> Array:
    """Return the parameters of a setting as one vector `(d,)`, identities where not given.

    A vector with numbers for each element may be given whole, or as the named element's own numbers.

    Raises
    ------
    UsageError
        When a parameter is unknown, has the wrong size, or lies outside its bounds.
    """
    kind = effect(setting.name)
    parameter_names = {p.name for p in kind.parameters}
    for name in setting.parameters:
        if name not in parameter_names:
            raise UnknownNameError(f"parameter of {setting.name}:", name, parameter_names)
    parts = [_numbers(setting, p, scene) for p in parameters_on(setting.name, scene, setting.element)]
    return np.concatenate(parts)


def _numbers(setting: EffectSetting, parameter: Parameter, scene: Scene) -> Array:
    """Return one parameter as a vector."""
    size = parameter.size(scene)
    if parameter.name not in setting.parameters:
        return np.full(size, parameter.identity(scene))
    value = setting.parameters[parameter.name]
    if isinstance(value, str):
        if value not in parameter.choices:
            raise UnknownNameError(f"{parameter.name} of {setting.name}:", value, parameter.choices)
        return np.array([float(parameter.choices.index(value))])
    array = _for_all_elements(np.atleast_1d(np.asarray(value, float)), parameter, scene, setting.element)
    low, high = parameter.bounds(scene)
    # A bound that went through a logarithm and back may lie a rounding error outside.
    clipped_array = np.clip(array, low, high)
    array = np.where(np.isclose(array, clipped_array, rtol=1e-9, atol=0), clipped_array, array)
    if array.shape != (size,) or not np.isfinite(array).all() or (array < low).any() or (array > high).any():
        count = acts_on_element(parameter, scene, setting.element).sum()
        raise UsageError(
            f"{setting.name}: {parameter.name} is not possible in scene {scene.name}",
            expected=f"{count} number(s) in [{low:g}, {high:g}] {parameter.unit}",
            found=str(value),
        )
    return array


def _for_all_elements(array: Array, parameter: Parameter, scene: Scene, element: str | None) -> Array:
    """Return a vector for all elements: the numbers of one, the identity elsewhere."""
    acts = acts_on_element(parameter, scene, element)
    if acts.all() or len(array) != acts.sum():
        return array
    numbers = np.full(len(acts), float(parameter.identity(scene)))
    numbers[acts] = array
    return numbers


def acts_on_element(parameter: Parameter, scene: Scene, element: str | None) -> NDArray[np.bool_]:
    """Return `(size,)` whether each number acts on `element`, or where none is named."""
    if parameter.owners is None or (element is None and parameter.whole is None):
        return np.ones(parameter.size(scene), bool)
    if element is None:
        joint_names = parameter.whole(scene) if parameter.whole else ()
    else:
        joint_names = scene.file.groups.get(element, (element,))
    return np.array([owner in joint_names for owner in parameter.owners(scene)], bool)


def turn(name: str) -> tuple[bool, str]:
    """Return the key by which effects are sorted whose hooks act one after another: early ones, then by name."""
    return not effect(name).early, name


def active(name: str, scene: Scene, element: str | None = None) -> NDArray[np.bool_]:
    """Return `(d,)` which numbers of the vector act: all, or those that belong to `element`."""
    return np.concatenate([acts_on_element(p, scene, element) for p in effect(name).parameters])


def setting(name: str, x: Array, scene: Scene, element: str | None = None) -> EffectSetting:
    """Return the setting of an effect whose parameters are the vector `x (d,)`.

    Of a vector with numbers for each element, a setting on one element holds that element's only.
    """
    parameters: dict[str, Value] = {}
    start = 0
    for p in effect(name).parameters:
        size = p.size(scene)
        part = x[start : start + size][acts_on_element(p, scene, element)]
        start += size
        if p.choices:
            parameters[p.name] = p.choices[int(part[0])]
        else:
            parameters[p.name] = float(part[0]) if len(part) == 1 else tuple(float(v) for v in part)
    return EffectSetting(name=name, element=element, parameters=parameters)
