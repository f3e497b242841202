"""Effects by name, and the way between settings (names) and vectors (numbers)."""

from __future__ import annotations

import numpy as np

from candata.effects._contract import Array, Effect, Parameter
from candata.errors import UnknownNameError, UsageError
from candata.plugins import load, names
from candata.scenes.assemble import Scene
from candata.schema.effect import EffectSetting, Value

PACKAGE = "candata.effects"


def effect_names() -> tuple[str, ...]:
    """Return the names of all effects: the files of the folder."""
    return names(PACKAGE)


def effect(name: str) -> Effect:
    """Return the effect called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    """
    found: Effect = load(PACKAGE, "EFFECT", name)
    return found


def flatten(given: EffectSetting, scene: Scene) -> Array:
    """Return the parameters of a setting as one vector `(d,)`, identities where not given.

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
    parts = [_numbers(given, p, scene) for p in kind.parameters]
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
    array = np.atleast_1d(np.asarray(value, float))
    low, high = parameter.bounds(scene)
    # A bound that went through a logarithm and back may lie a rounding error outside.
    rounded = np.clip(array, low, high)
    array = np.where(np.isclose(array, rounded, rtol=1e-9, atol=0), rounded, array)
    if array.shape != (size,) or not np.isfinite(array).all() or (array < low).any() or (array > high).any():
        raise UsageError(
            f"{given.name}: {parameter.name} is not possible in scene {scene.name}",
            expected=f"{size} number(s) in [{low:g}, {high:g}] {parameter.unit}",
            found=str(value),
        )
    return array


def setting(name: str, x: Array, scene: Scene, element: str | None = None) -> EffectSetting:
    """Return the setting of an effect whose parameters are the vector `x (d,)`."""
    parameters: dict[str, Value] = {}
    start = 0
    for p in effect(name).parameters:
        size = p.size(scene)
        part = x[start : start + size]
        start += size
        if p.choices:
            parameters[p.name] = p.choices[int(part[0])]
        else:
            parameters[p.name] = float(part[0]) if size == 1 else tuple(float(v) for v in part)
    return EffectSetting(name=name, element=element, parameters=parameters)
