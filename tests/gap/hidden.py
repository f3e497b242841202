"""Worlds with a cause that is in no library: made by the hooks of an effect that only the test knows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from candata.effects import EFFECTS, Bounds, Effect, Hook, Parameter
from candata.plugins import Registry
from candata.schema.effect import EffectSetting

NAME = "hidden"
#: An effect has at least one number; this one does nothing.
NUMBER = Parameter("x", "1", lambda s: Bounds(0, 1), lambda s: (), lambda s: (), "made up", lambda s: 0.0)


def _remembering(change: Callable) -> Hook:
    """A hook whose memory is a dict."""

    def apply(state, x):
        scene, memory = state
        return state, change(scene, memory, x)

    return Hook(lambda scene, x, elements: (scene, {}), apply)


def force(added: Callable) -> Effect:
    """A cause that adds `added(scene, memory, x) -> (n, nv)`."""
    hook = _remembering(lambda scene, memory, x: x._replace(added=x.added + added(scene, memory, x)))
    return Effect("hidden", (NUMBER,), "joint", lambda scene: True, force=hook)


def reading(changed: Callable) -> Effect:
    """A cause that changes what sensors read, `changed(scene, memory, readings) -> readings`."""
    return Effect("hidden", (NUMBER,), "fingertip", lambda scene: True, reading=_remembering(changed))


def on_joint(name: str, torque: Callable) -> Effect:
    """A cause on one joint: `torque(position, effort, memory) -> (n,)`."""

    def added(scene, memory, x):
        j = scene.file.joints.index(name)
        out = np.zeros_like(x.added)
        out[:, scene.joint_dof[j]] = torque(x.qpos[:, scene.joint_qpos[j]], x.effort[:, scene.joint_dof[j]], memory)
        return out

    return force(added)


def on_object(newton: tuple[float, float, float]) -> Effect:
    """A steady wind on the object."""

    def added(scene, memory, x):
        out = np.zeros_like(x.added)
        out[:, scene.object_dof : scene.object_dof + 3] = newton
        return out

    return force(added)


def stiction(share: float, width: float) -> Callable:
    """Dry friction that grows with the effort, with bristles of a width."""

    def torque(position, effort, memory):
        bend = memory.get("bend", np.zeros_like(position)) + (position - memory.get("position", position)) / width
        memory["bend"], memory["position"] = np.clip(bend, -1, 1), position.copy()
        return -share * np.abs(effort) * memory["bend"]

    return torque


def hysteresis(tip: str, share: float) -> Effect:
    """A fingertip that reads more while its load rises than while it falls."""

    def changed(scene, memory, readings):
        f = scene.file.fingertips.index(tip)
        now = readings["fingertip_force"]
        bend = memory.get("bend", np.zeros_like(now[:, f])) + (now[:, f] - memory.get("now", now[:, f])) / 0.2
        memory["bend"], memory["now"] = np.clip(bend, -1, 1), now[:, f].copy()
        out = now.copy()
        out[:, f] += share * np.abs(now[:, f]) * memory["bend"]
        return {**readings, "fingertip_force": out}

    return reading(changed)


def hider(patch: pytest.MonkeyPatch) -> Callable[[Effect], tuple[EffectSetting, ...]]:
    """The function that makes a cause known under a name until the patch is undone, and returns its settings."""
    causes: dict[str, Effect] = {}
    load = Registry.load

    def load_or_cause(registry: Registry, name: str) -> object:
        return causes[name] if registry is EFFECTS and name in causes else load(registry, name)

    patch.setattr(Registry, "load", load_or_cause)

    def hide(cause: Effect) -> tuple[EffectSetting, ...]:
        causes[NAME] = cause
        return (EffectSetting(name=NAME),)

    return hide
