"""Pairs of a joint and the command that drives it, as far as names tell."""

from __future__ import annotations

from candata.checks._view import EpisodeView
from candata.scenes.motors import affine_law


def pairs(view: EpisodeView) -> tuple[tuple[int, int], ...]:
    """Return `(column of joint_position, column of action)` of each driven joint.

    By name; by place where an episode has as many commands as joints and names neither, or both alike. Only position
    servos, where the scene is known: what motors and velocity servos are told is no place.
    """
    return tuple((j, a) for j, a in _columns_by_name(view) if _is_place(view, a))


def _is_place(view: EpisodeView, column: int) -> bool:
    """Tell whether a command says where a joint is to go, as far as is known."""
    scene, names = view.scene, view.elements("action")
    if scene is None or names[column] not in scene.file.actuator_names:
        return True
    actuator = scene.actuator_ids[scene.file.actuator_names.index(names[column])]
    _, bias = affine_law(scene.model, [actuator])
    return bool(bias[0, 1] != 0)


def _columns_by_name(view: EpisodeView) -> tuple[tuple[int, int], ...]:
    """Return `(column of joint_position, column of action)` of each joint and the command of its name or place."""
    if not {"joint_position", "action"} <= view.raw.arrays.keys() or view.meta is None:
        return ()
    joint, action = view.raw.arrays["joint_position"], view.raw.arrays["action"]
    if joint.ndim != 2 or action.ndim != 2:
        return ()
    joints, actuators = view.meta.joint_names, view.meta.actuator_names
    if len(joints) == joint.shape[1] and len(actuators) == action.shape[1]:
        return tuple((j, actuators.index(name)) for j, name in enumerate(joints) if name in actuators)
    is_by_place = joint.shape[1] == action.shape[1] and not joints and not actuators
    return tuple((j, j) for j in range(joint.shape[1])) if is_by_place else ()
