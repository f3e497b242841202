"""Worlds: a scene with effects, one private model and one set of filters for each simulation of a batch."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.effects import Hook, effect, flatten, turn
from candata.errors import UsageError
from candata.scenes import Scene
from candata.schema.effect import EffectSetting

Array = NDArray[np.float64]
EffectList = Sequence[EffectSetting]


@dataclass(frozen=True)
class Filter:
    """One hook with its starting state for a batch."""

    apply: Callable[[Any, Any], tuple[Any, Any]]
    state: Any


@dataclass(frozen=True)
class Worlds:
    """What differs between the simulations of a batch.

    Attributes
    ----------
    models : list of MjModel
        One a simulation; simulations without model edits share the scene's, unless friction or the strength of drives
        changes from step to step.
    pace : (n,) float64
        True time that passes during one recorded row, in nominal control steps.
    command, force, friction, drive, servo, reading : tuple of Filter
        Hooks of the effects present, in the order in which they act.
    """

    models: list[mujoco.MjModel]
    pace: Array
    command: tuple[Filter, ...]
    force: tuple[Filter, ...]
    friction: tuple[Filter, ...]
    drive: tuple[Filter, ...]
    servo: tuple[Filter, ...]
    reading: tuple[Filter, ...]


def build_worlds(scene: Scene, effects: Sequence[EffectList]) -> Worlds:
    """Return the worlds of n simulations, each with its own list of effects.

    Raises
    ------
    UsageError
        When an effect cannot act in the scene, or its parameters are not possible there.
    """
    cache: dict[str, mujoco.MjModel] = {}
    models = [_model(scene, tuple(settings), cache) for settings in effects]
    kinds: dict[str, list[Filter]] = {
        kind: [] for kind in ("command", "force", "friction", "drive", "servo", "reading")
    }
    given = [scene.given_effects] * len(effects)
    for name in sorted({s.name for settings in (scene.given_effects, *effects) for s in settings}, key=turn):
        for hook_name, filters in kinds.items():
            hook: Hook | None = getattr(effect(name), hook_name)
            if hook is not None:
                filters += _filters(scene, scene.plain or scene, name, hook, given)
                filters += _filters(scene, scene, name, hook, effects)
    kinds["command"] += _shifted_commands(scene, models)
    pace = np.array([_pace(scene, settings) for settings in effects])
    if kinds["friction"] or kinds["drive"]:
        models = [copy.copy(model) for model in models]
    return Worlds(models, pace, **{kind: tuple(filters) for kind, filters in kinds.items()})


def _shifted_commands(scene: Scene, models: Sequence[mujoco.MjModel]) -> list[Filter]:
    """Return the filter that moves commands as far as edits moved their range; none where they moved none.

    That is how a law without a constant, a DC motor's, follows an encoder that is off: kp (u + shift - q).
    """
    plain = (scene.plain or scene).model
    lowest = [model.actuator_ctrlrange[scene.actuator_ids, 0] for model in (plain, *models)]
    shift = np.stack(lowest)[1:] - lowest[0]
    return [Filter(lambda state, u: (state, u + state[:, None]), shift)] if shift.any() else []


def with_effects(scene: Scene, settings: EffectList) -> Scene:
    """Return the scene of which some effects are part: what is added to it acts after them.

    Edits of the model are in its `model`, other hooks act wherever it is simulated. Effects that a scene has already
    stay.

    Raises
    ------
    UnknownNameError
        When there is no such effect or parameter.
    UsageError
        When an effect cannot act in the scene, or its parameters are not possible there.
    """
    if not settings:
        return scene
    (model,) = build_worlds(scene, [settings]).models
    given_effects = (*scene.given_effects, *settings)
    return replace(
        scene, model=model, given_effects=given_effects, plain=scene.plain or scene, spec=None, unlabelled=None
    )


def all_effects(scene: Scene, settings: EffectList) -> tuple[EffectSetting, ...]:
    """Return the effects that make of the plain scene what `settings` make of the scene with its given effects.

    An effect that is there twice acts twice; one that replaces a value of the model takes the place of the former.
    """
    replaced = {(s.name, s.element) for s in settings if effect(s.name).replaces(scene)}
    return (*(s for s in scene.given_effects if (s.name, s.element) not in replaced), *settings)


def _numbers(scene: Scene, settings: EffectList) -> list[tuple[EffectSetting, Array]]:
    """Return the scene's own effects and those of a world, in the order in which they act, with their numbers `(d,)`.

    What is possible of the scene's own is said by the scene without them.
    """
    plain = scene.plain or scene
    pairs = [(s, flatten(s, plain)) for s in scene.given_effects] + [(s, flatten(s, scene)) for s in settings]
    return sorted(pairs, key=lambda pair: turn(pair[0].name))


def _pace(scene: Scene, settings: EffectList) -> float:
    """Return the true time of one recorded row, in nominal control steps."""
    hooks = [(effect(s.name).pace, x) for s, x in _numbers(scene, settings)]
    return float(np.prod([hook(scene, x) for hook, x in hooks if hook is not None]))


def true_state(scene: Scene, readings: Mapping[str, Array], settings: EffectList) -> dict[str, Array]:
    """Return what is true where `readings` was read at rest in a world with some effects: where its replay starts.

    Parameters
    ----------
    scene : Scene
    readings : mapping of str to ndarray
        `object_pose (..., 7)`, `joint_position (..., J)`; others pass through.
    settings : sequence of EffectSetting
        Effects of the world, beside those that belong to the scene.
    """
    out = dict(readings)
    for s, x in reversed(_numbers(scene, settings)):  # against the stepping loop's order
        hook = effect(s.name).unread
        if hook is not None:
            out = hook(scene, x, s.element, out)
    return out


def followed_readings(scene: Scene, readings: Mapping[str, Array], settings: EffectList) -> dict[str, Array]:
    """Return what an observer follows where `readings` was read in a world with some effects: what is true, on time.

    Pulled by what comes late, a state swings about its recording, and an object that lies still would seem to speak
    against a latency.

    Parameters
    ----------
    scene : Scene
    readings : mapping of str to ndarray
        `object_pose (E, T, 7)`, `joint_position (E, T, J)`; others pass through.
    settings : sequence of EffectSetting
        Effects of the world.

    Returns
    -------
    dict of str to ndarray
        NaN in the last rows of a channel that is late.
    """
    out = true_state(scene, readings, settings)
    for s, x in _numbers(scene, settings):
        hook = effect(s.name).on_time
        if hook is not None:
            out = hook(scene, x, s.element, out)
    return out


def _filters(scene: Scene, ranges: Scene, name: str, hook: Hook, effects: Sequence[EffectList]) -> list[Filter]:
    """Return the filters of one effect: several where a simulation has it several times, as on several elements.

    The scene of `ranges` says what values are possible.
    """
    layers = max(sum(s.name == name for s in settings) for settings in effects)
    filters = []
    for layer in range(layers):
        layer_settings = [_nth(settings, name, layer) for settings in effects]
        x = np.stack([flatten(s, ranges) for s in layer_settings])
        filters.append(Filter(hook.apply, hook.start(scene, x, [s.element for s in layer_settings])))
    return filters


def _nth(settings: EffectList, name: str, layer: int) -> EffectSetting:
    """Return the `layer`-th setting called `name`, or the identity."""
    matches = [s for s in settings if s.name == name]
    return matches[layer] if layer < len(matches) else EffectSetting(name=name)


def _model(scene: Scene, settings: tuple[EffectSetting, ...], cache: dict[str, mujoco.MjModel]) -> mujoco.MjModel:
    """Return the scene's model, or a private copy with the edits of `settings`."""
    for s in settings:
        if not effect(s.name).possible(scene):
            raise UsageError(
                f"effect {s.name} cannot act in scene {scene.name}",
                expected=f"a scene with what it acts on ({effect(s.name).acts_on})",
                fix="remove it from the effects",
            )
        if s.element is not None and not effect(s.name).elements(scene):
            raise UsageError(
                f"effect {s.name} has no elements",
                expected="element: null",
                found=s.element,
                fix="leave the element out",
            )
    edits = tuple(s for s in settings if effect(s.name).edit is not None)
    if not edits:
        return scene.model
    key = "\n".join(s.model_dump_json() for s in edits)
    if key not in cache:
        cache[key] = _edited_model(scene, edits)
    return cache[key]


def _edited_model(scene: Scene, edits: tuple[EffectSetting, ...]) -> mujoco.MjModel:
    """Return a copy of the scene's model with the edits applied."""
    model = copy.copy(scene.model)
    for s in edits:
        kind = effect(s.name)
        x = flatten(s, scene)
        if kind.edit is not None and np.isfinite(x).all():
            kind.edit(model, scene, x, s.element)
    if any(effect(s.name).set_const for s in edits):
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model
