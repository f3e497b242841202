"""The dictionary of a residual force: what it may depend on, as functions of motion, effort and contact."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.effects._contract import Array, Forces
from candata.scenes.assemble import Scene, subtree

#: Travel over which a friction-like term turns from one sign to the other [rad or m]: the play of its bristles
#: (Dahl 1968, "A solid friction model"), ten times the resolution of good encoders.
BRISTLE_RAD, BRISTLE_M = 0.02, 0.001
#: Speed from which the object counts as moving [m/s, rad/s]; slower motion is drowned in the noise of a pose.
SLOW_MPS, SLOW_RADPS = 0.03, 0.3
#: Time in which the memory of past effort fades [s]: between a wire that warms up and a gear that does.
MEMORY_S = 4.0
#: Rise of the object above its start from which it counts as off its support [m].
OFF_M = 0.004
#: Heights above its start over which what draws the object to its support fades to 1/e [m]: from films and skins that
#: stick to magnets.
NEAR_M = (0.005, 0.015, 0.045)

#: Terms of a joint, and what each is said to depend on.
JOINT_TERMS: tuple[tuple[str, ...], ...] = (
    ("constant",),
    ("position",),
    ("velocity",),
    ("sign of velocity",),
    ("load",),
    ("sign of velocity", "load"),
    ("sign of velocity", "fingertip force"),
    ("memory", "load"),
    ("time",),
    ("time", "load"),
    ("periodic position",),
    ("periodic position",),
)
#: Terms of the object; each is a force or a torque along three axes.
OBJECT_TERMS: tuple[tuple[str, ...], ...] = (
    ("constant",),
    ("off the support",),
    ("nearness to the support",),
    ("nearness to the support",),
    ("nearness to the support",),
    ("in contact",),
    ("fingertip force",),
    ("position",),
    ("velocity",),
    ("sign of velocity",),
    ("time",),
)
AXES = 6


class TermMemory(NamedTuple):
    """What the terms remember of n simulations.

    Attributes
    ----------
    row : int
        Control steps since the beginning.
    joints, start : (n, J), (n, nq) float64
        Joint positions of the step before, and the state of the first.
    bristle : (n, J) float64
        Bend of the friction's bristles, from -1 to 1.
    memory : (n, J) float64
        Size of the effort, averaged over what is remembered [N, N m].
    """

    row: int
    joints: Array
    start: Array
    bristle: Array
    memory: Array


class Terms(NamedTuple):
    """Values of the dictionary, `joint (n, J, K)` and `object (n, K, 6)`."""

    joint: Array
    object: Array


def sizes(scene: Scene) -> tuple[int, int]:
    """Return how many coefficients the joints have, and the object."""
    has_object = scene.object_id is not None
    return len(scene.joint_ids) * len(JOINT_TERMS), AXES * len(OBJECT_TERMS) * has_object


def terms(scene: Scene, earlier: TermMemory | None, x: Forces, waves: Array) -> tuple[TermMemory, Terms]:
    """Return the values of all terms at the beginning of a control step, and what they remember.

    Parameters
    ----------
    scene : Scene
    earlier : Past or None
        None at the first step.
    x : Forces
        Motion, effort and contact of n simulations.
    waves : (n, J) float64
        Wave number of the periodic terms [rad per rad or m].
    """
    positions = x.qpos[:, scene.joint_qpos]
    effort = x.effort[:, scene.joint_dof]
    if earlier is None:
        earlier = TermMemory(0, positions, x.qpos.copy(), np.zeros_like(positions), np.zeros_like(positions))
    bristle = np.clip(earlier.bristle + (positions - earlier.joints) / _width(scene), -1.0, 1.0)
    fade = 1 / (MEMORY_S * scene.file.rate_hz)
    memory = earlier.memory + fade * (np.abs(effort) - earlier.memory)
    time = np.full_like(positions, earlier.row / scene.file.rate_hz)
    tips = np.sqrt((x.tip_force**2).sum(-1)) @ _tip_carriers(scene).T
    joint = np.stack(
        [
            np.ones_like(positions),
            positions,
            x.qvel[:, scene.joint_dof],
            bristle,
            effort,
            bristle * np.abs(effort),
            bristle * tips,
            memory * effort,
            time,
            time * effort,
            np.sin(waves * positions),
            np.cos(waves * positions),
        ],
        axis=-1,
    )
    return TermMemory(earlier.row + 1, positions, earlier.start, bristle, memory), Terms(
        joint, _object_terms(scene, earlier, x)
    )


def _object_terms(scene: Scene, earlier: TermMemory, x: Forces) -> Array:
    """Return `(n, K, 6)` the object's terms; empty without one."""
    n = len(x.qpos)
    if scene.object_id is None:
        return np.zeros((n, 0, AXES))
    at, dof = scene.object_qpos, scene.object_dof
    shift, velocity = x.qpos[:, at : at + 3] - earlier.start[:, at : at + 3], x.qvel[:, dof : dof + AXES]
    height = np.maximum(shift[:, 2], 0.0)
    nearness = [np.exp(-height / fades) * (scene.file.support is not None) for fades in NEAR_M]
    flags = (np.ones(n), off_support(scene, earlier, x), *nearness, x.touch, np.sqrt((x.tip_force**2).sum((1, 2))))
    constant_terms = [np.repeat(np.asarray(f, float)[:, None], AXES, axis=1) for f in flags]
    place = np.concatenate([shift, np.zeros((n, 3))], axis=1)
    sign = np.tanh(velocity / np.repeat([SLOW_MPS, SLOW_RADPS], 3))
    time = np.full((n, AXES), earlier.row / scene.file.rate_hz)
    return np.stack([*constant_terms, place, velocity, sign, time], axis=1)


def off_support(scene: Scene, earlier: TermMemory, x: Forces) -> NDArray[np.bool_]:
    """Return `(n,)` whether the object stands higher than where it began; always where there is no support."""
    at = scene.object_qpos + 2
    return (x.qpos[:, at] - earlier.start[:, at] > OFF_M) | (scene.file.support is None)


def _width(scene: Scene) -> Array:
    """Return `(J,)` the travel of the bristles [rad or m]."""
    slides = scene.model.jnt_type[scene.joint_ids] == mujoco.mjtJoint.mjJNT_SLIDE
    return np.where(slides, BRISTLE_M, BRISTLE_RAD)


def _tip_carriers(scene: Scene) -> Array:
    """Return `(J, F)` 1 where a joint carries a fingertip, else 0."""
    model = scene.model
    subtrees = [subtree(model, int(model.jnt_bodyid[j])) for j in scene.joint_ids]
    count = len(scene.force_sensors)
    tips = scene.fingertip_bodies[:count]
    return np.array([[float(int(b) in body) for b in tips] for body in subtrees]).reshape(len(subtrees), count)
