"""The contracts of an arm, of a hand, of an object and of a built-in scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco

from candata.plugins import Registry
from candata.schema.object import ObjectFile
from candata.schema.scene import SceneFile


@dataclass(frozen=True)
class Arm:
    """An arm: how to add it to a scene, and where a hand is mounted.

    Attributes
    ----------
    name : str
        Registered name, the file's name.
    add : callable
        `(spec, parent body, place [m], quat w x y z)` adds bodies, joints and servos.
    joints : tuple of str
        Joints from the base outwards; actuators bear the same names.
    flange : str
        Site that carries a hand; its +z leads out of the arm.
    start : tuple of float
        Joints [rad] of a posture from which the hand can be moved any way.
    """

    name: str
    add: Callable[[mujoco.MjSpec, mujoco.MjsBody, tuple[float, float, float], tuple[float, float, float, float]], None]
    joints: tuple[str, ...]
    flange: str
    start: tuple[float, ...]


@dataclass(frozen=True)
class Hand:
    """A hand: how to add it to a scene, and the roles of its parts.

    Attributes
    ----------
    name : str
        Registered name, the file's name.
    add : callable
        `(spec, parent body, quat w x y z)` adds bodies, joints and servos.
    joints : tuple of str
        Joints in the order of `joint_position`; actuators bear the same names.
    fingertips, fingertip_frames : tuple of str
        Force-sensing bodies and the sites that carry their frames (a pressing contact reads +z).
    """

    name: str
    add: Callable[[mujoco.MjSpec, mujoco.MjsBody, tuple[float, float, float, float]], None]
    joints: tuple[str, ...]
    fingertips: tuple[str, ...]
    fingertip_frames: tuple[str, ...]


@dataclass(frozen=True)
class BuiltinScene:
    """A scene of the library: its roles and how to build its model.

    Attributes
    ----------
    file : SceneFile
        The same record as a user's `scene.yaml`; `model` is the word `builtin`.
    build : callable
        Returns a fresh MjSpec.
    policies : tuple of str
        Policies that `generate-sim` plays in it by default.
    about : str
        One line for people.
    """

    file: SceneFile
    build: Callable[[], mujoco.MjSpec]
    policies: tuple[str, ...]
    about: str


@dataclass(frozen=True)
class SceneObject:
    """An object that a scene may hold.

    Attributes
    ----------
    file : ObjectFile
        The same record as a user's `object.yaml`; the name in it is the registered one.
    folder : Path, optional
        Where the files of its meshes lie; None where it has none.
    """

    file: ObjectFile
    folder: Path | None = None

    @property
    def name(self) -> str:
        """Name of the object, and of its body in a scene."""
        return self.file.name

    @property
    def about(self) -> str:
        """One line for people."""
        return self.file.about


ARMS = Registry("arms", "candata.scenes.arms", "ARM", Arm, "name")
HANDS = Registry("hands", "candata.scenes.hands", "HAND", Hand, "name")
OBJECTS = Registry("objects", "candata.scenes.objects", "OBJECT", SceneObject, "about")
SCENES = Registry("scenes", "candata.scenes.library", "SCENE", BuiltinScene, "about")
