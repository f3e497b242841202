"""Effects by name, and the way between settings (names) and vectors (numbers)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.effects import _contact, _select
from candata.effects._contract import Array, Effect, Parameter, Trait
from candata.errors import UnknownNameError, UsageError
from candata.plugins import Registry
from candata.scenes.assemble import Scene
from candata.schema.effect import EffectSetting, Value

EFFECTS = Registry("effects", "candata.effects", "EFFECT", Effect, "about")


def effect_names() -> tuple[str, ...]:
    """Return the names of all effects that are searched and drawn: every one but those that are only fitted."""
    return tuple(name for name, kind in EFFECTS.load_all().items() if not kind.fitted)


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
    measured = any(p.rails for p in effect(name).parameters)
    return _select.fingers(scene) if measured else _select.usual(scene)


def members_of(name: str, scene: Scene, element: str) -> tuple[str, ...]:
    """Return the joints of a group, or the fingertips where an element is all of them; else the element alone."""
    if effect(name).acts_on == "joint":
        return scene.file.groups.get(element, (element,))
    return _contact.members(scene, element)


def rail_units(name: str, scene: Scene, element: str | None = None) -> dict[str, str]:
    """Return the units of an effect's parameters that are others than their names say, on joints that slide."""
    pairs = zip(effect(name).parameters, parameters_on(name, scene, element), strict=True)
    return {p.name: there.unit for p, there in pairs if there.unit != p.unit}


def flatten(given: EffectSetting, scene: Scene) -> Array:
    """Return the parameters of a setting as one vector `(d,)`, identities where not given.

    A vector with numbers for each element may be given whole, or as the named element's own numbers.

    Raises
    ------
    UsageError
        When a parameter is unknown, has the wrong size, or lies outside its bounds.
    """
    kind = effect(given.name)
    known = {p.name for p in kind.parameters}
    for name in given.parameters:
        if name not in known:
            raise UnknownNameError(f"parameter of {given.name}:", name, known)
    parts = [_numbers(given, p, scene) for p in parameters_on(given.name, scene, given.element)]
    return np.concatenate(parts)


def _numbers(given: EffectSetting, parameter: Parameter, scene: Scene) -> Array:
    """Return one parameter as a vector."""
    size = parameter.size(scene)
    if parameter.name not in given.parameters:
        return np.full(size, parameter.identity(scene))
    value = given.parameters[parameter.name]
    if isinstance(value, str):
        if value not in parameter.choices:
            raise UnknownNameError(f"{parameter.name} of {given.name}:", value, parameter.choices)
        return np.array([float(parameter.choices.index(value))])
    array = _whole(np.atleast_1d(np.asarray(value, float)), parameter, scene, given.element)
    low, high = parameter.bounds(scene)
    # A bound that went through a logarithm and back may lie a rounding error outside.
    rounded = np.clip(array, low, high)
    array = np.where(np.isclose(array, rounded, rtol=1e-9, atol=0), rounded, array)
    if array.shape != (size,) or not np.isfinite(array).all() or (array < low).any() or (array > high).any():
        count = _owned(parameter, scene, given.element).sum()
        raise UsageError(
            f"{given.name}: {parameter.name} is not possible in scene {scene.name}",
            expected=f"{count} number(s) in [{low:g}, {high:g}] {parameter.unit}",
            found=str(value),
        )
    return array


def _whole(array: Array, parameter: Parameter, scene: Scene, element: str | None) -> Array:
    """Return a vector for all elements: the numbers of one, the identity elsewhere."""
    mine = _owned(parameter, scene, element)
    if mine.all() or len(array) != mine.sum():
        return array
    whole = np.full(len(mine), float(parameter.identity(scene)))
    whole[mine] = array
    return whole


def _owned(parameter: Parameter, scene: Scene, element: str | None) -> NDArray[np.bool_]:
    """Return `(size,)` whether each number acts on `element`, or where none is named."""
    if parameter.owners is None or (element is None and parameter.whole is None):
        return np.ones(parameter.size(scene), bool)
    if element is None:
        own = parameter.whole(scene) if parameter.whole else ()
    else:
        own = scene.file.groups.get(element, (element,))
    return np.array([owner in own for owner in parameter.owners(scene)], bool)


def turn(name: str) -> tuple[bool, str]:
    """Return the key by which effects are sorted whose hooks act one after another: early ones, then by name."""
    return not effect(name).early, name


def active(name: str, scene: Scene, element: str | None = None) -> NDArray[np.bool_]:
    """Return `(d,)` which numbers of the vector act: all, or those that belong to `element`."""
    return np.concatenate([_owned(p, scene, element) for p in effect(name).parameters])


def setting(name: str, x: Array, scene: Scene, element: str | None = None) -> EffectSetting:
    """Return the setting of an effect whose parameters are the vector `x (d,)`.

    Of a vector with numbers for each element, a setting on one element holds that element's only.
    """
    parameters: dict[str, Value] = {}
    start = 0
    for p in effect(name).parameters:
        size = p.size(scene)
        part = x[start : start + size][_owned(p, scene, element)]
        start += size
        if p.choices:
            parameters[p.name] = p.choices[int(part[0])]
        else:
            parameters[p.name] = float(part[0]) if len(part) == 1 else tuple(float(v) for v in part)
    return EffectSetting(name=name, element=element, parameters=parameters)
