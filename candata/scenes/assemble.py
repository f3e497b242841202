"""Scene: a compiled model plus roles, assembled from `scene.yaml` or the library."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import SceneError, UnknownNameError, UsageError, Where
from candata.scenes import motors, sensors, transmission
from candata.scenes.composition import compose
from candata.scenes.contract import SCENES
from candata.scenes.model_file import compile_model, model_path, read_model
from candata.scenes.named_files import kind_of
from candata.scenes.object_change import replace_object
from candata.scenes.object_folder import named_object
from candata.scenes.role_check import check_recorded, check_roles
from candata.scenes.step_check import check_commands, check_rate
from candata.schema.effect import EffectSetting
from candata.schema.html_text import summary_table
from candata.schema.scene import ArmWithHand, SceneFile, Servo
from candata.schema.yaml_text import read_yaml

#: Endings of files that are models.
_MODELS = (".xml", ".urdf", ".mjcf", ".mjb", ".xacro")
#: Stands between a scene and the object that takes the place of its own.
OBJECT_MARK = "+"


@dataclass(frozen=True, eq=False)
class Scene:
    """A model and which of its parts are the hand, the object, the fingertips.

    Attributes
    ----------
    name : str
        Name in the library or path of the `scene.yaml`.
    file : SceneFile
        The roles as the user wrote them.
    model : mujoco.MjModel
        Compiled with the force sensors of the fingertips added and `jacobian="dense"`; edited by the given effects.
    policies : tuple of str
        Policies that suit the scene; all that can act where there are none.
    given_effects : tuple of EffectSetting
        Effects that belong to the nominal simulator, see `candata.simulate.with_effects`.
    plain : Scene or None
        The scene without them; None where there are none.
    has_other_object : bool
        Whether another object is in the place of the scene's own: its keyframes know nothing of it.
    spec : mujoco.MjSpec or None
        What the model was compiled from; None where it was edited since.
    unlabelled : Scene or None
        The scene without labels, see `candata.scenes.labels`; None where there are none.
    """

    name: str
    file: SceneFile
    model: mujoco.MjModel
    policies: tuple[str, ...] = ()
    given_effects: tuple[EffectSetting, ...] = ()
    plain: Scene | None = None
    has_other_object: bool = False
    spec: mujoco.MjSpec | None = field(default=None, repr=False)
    unlabelled: Scene | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        """Return name, size and rate in one line."""
        counts = ", ".join(f"{len(members)} {role}" for role, members in self._members().items())
        return f"Scene({self.name!r}, {counts}, object {self.file.object!r}, {self.file.rate_hz:g} Hz)"

    def _repr_html_(self) -> str:
        """Return the roles as a table: what a notebook shows."""
        rows = [(role, len(members), ", ".join(members)) for role, members in self._members().items()]
        rows += [
            (role, 1, name) for role, name in (("object", self.file.object), ("support", self.file.support)) if name
        ]
        step = f"{self.file.rate_hz:g} Hz, {self.substeps} physics steps of {1e3 * self.model.opt.timestep:g} ms each"
        return summary_table(f"Scene {self.name}", step, ("role", "count", "names"), rows)

    def _members(self) -> dict[str, tuple[str, ...]]:
        """Return the names of each role that has several."""
        file = self.file
        return {"joints": file.joints, "actuators": file.actuator_names, "fingertips": file.fingertips}

    @property
    def substeps(self) -> int:
        """Physics steps a control step."""
        return max(1, round(1 / self.file.rate_hz / self.model.opt.timestep))

    @cached_property
    def joint_ids(self) -> NDArray[np.int64]:
        """`(J,)` joint ids in the order of `joint_position`."""
        return np.array([self.model.joint(j).id for j in self.file.joints], int)

    @cached_property
    def joint_qpos(self) -> NDArray[np.int64]:
        """`(J,)` addresses in qpos."""
        return self.model.jnt_qposadr[self.joint_ids]

    @cached_property
    def joint_dof(self) -> NDArray[np.int64]:
        """`(J,)` addresses in qvel."""
        return self.model.jnt_dofadr[self.joint_ids]

    @cached_property
    def sliding(self) -> NDArray[np.bool_]:
        """`(J,)` which joints slide."""
        return np.asarray(self.model.jnt_type[self.joint_ids] == mujoco.mjtJoint.mjJNT_SLIDE)

    @cached_property
    def actuator_ids(self) -> NDArray[np.int64]:
        """`(A,)` actuator ids in the order of `action`."""
        return np.array([self.model.actuator(a).id for a in self.file.actuator_names], int)

    @cached_property
    def driven_joints(self) -> dict[int, int]:
        """Joint id of each actuator id that drives a joint; actuators of tendons and bodies drive none."""
        return transmission.driven_joints(self.model, self.actuator_ids.tolist())

    @cached_property
    def levers(self) -> dict[int, dict[int, float]]:
        """Joint ids that each actuator id pulls, a tendon's too, with its length for each unit of the joint."""
        return transmission.levers(self.model, self.actuator_ids.tolist())

    def stiffness(self, actuators: Sequence[int] | NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the position gains `(n,)` of actuators: a servo's gain on its length, else that on its command."""
        gain, bias = motors.affine_law(self.model, actuators)
        return np.where(bias[:, 1] < 0, -bias[:, 1], gain)

    @cached_property
    def driven_hinges(self) -> NDArray[np.int64]:
        """Indices into `file.joints` of hinge joints that an actuator pulls: drive effects act on these."""
        pulled_joints = {joint for lever_arms in self.levers.values() for joint in lever_arms}
        hinge = mujoco.mjtJoint.mjJNT_HINGE
        return np.array(
            [i for i, j in enumerate(self.joint_ids) if j in pulled_joints and self.model.jnt_type[j] == hinge], int
        )

    @cached_property
    def object_id(self) -> int | None:
        """Body id of the object, or None."""
        return None if self.file.object is None else self.model.body(self.file.object).id

    @cached_property
    def object_qpos(self) -> int:
        """Address of the object's pose in qpos."""
        return int(self.model.jnt_qposadr[self.model.body_jntadr[self._object()]])

    @cached_property
    def object_dof(self) -> int:
        """Address of the object's velocity in qvel."""
        return int(self.model.jnt_dofadr[self.model.body_jntadr[self._object()]])

    def _object(self) -> int:
        if self.object_id is None:
            raise SceneError(f"scene {self.name} has no object", fix="name it: `object: BODY`")
        return self.object_id

    @cached_property
    def object_geoms(self) -> NDArray[np.int64]:
        """Ids of the object's colliding geoms."""
        if self.object_id is None:
            return np.zeros(0, int)
        return _colliding_geoms(self.model, subtree(self.model, self.object_id))

    @cached_property
    def fingertip_bodies(self) -> NDArray[np.int64]:
        """`(F,)` ids of the bodies that carry the fingertips."""
        return np.array([_carrier(self.model, tip) for tip in self.file.fingertips], int)

    @cached_property
    def fingertip_geoms(self) -> tuple[NDArray[np.int64], ...]:
        """Ids of each fingertip's colliding geoms: the geom itself, or those of its body and of what that carries."""
        return tuple(
            np.array([self.model.geom(tip).id])
            if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, tip) < 0
            else _colliding_geoms(self.model, subtree(self.model, int(body)))
            for tip, body in zip(self.file.fingertips, self.fingertip_bodies, strict=True)
        )

    @cached_property
    def force_sensors(self) -> NDArray[np.int64]:
        """`(F, 3)` addresses of the world-frame forces in sensordata: of all contacts of each fingertip, on it."""
        return self._sensor(sensors.FORCE, 3)

    @cached_property
    def internal_sensors(self) -> dict[int, NDArray[np.int64]]:
        """Addresses `(3,)` of the forces that the bodies of one fingertip exert on one another: no force from outside.

        Keyed by the fingertip's index; only fingertips that consist of several bodies have one.
        """
        sensor_of = {
            name: self.model.sensor(name)
            for name in (f"{sensors.INTERNAL}{i}" for i in range(len(self.file.fingertips)))
            if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, name) >= 0
        }
        return {int(name.removeprefix(sensors.INTERNAL)): s.adr[0] + np.arange(3) for name, s in sensor_of.items()}

    @cached_property
    def frame_sensors(self) -> NDArray[np.int64]:
        """`(F, 4)` addresses of the frames' quaternions in sensordata."""
        return self._sensor(sensors.FRAME, 4)

    @cached_property
    def collision_sensors(self) -> NDArray[np.int64]:
        """`(F,)` addresses of the numbers of contacts of each fingertip with the object; empty without labels."""
        return self._sensor(sensors.COLLISION, 1)[:, 0]

    @cached_property
    def contact_sensors(self) -> NDArray[np.int64]:
        """`(F, slots, numbers)` addresses of each contact of a fingertip (`sensors.CONTACT_SIZE`); empty likewise."""
        slots, size = sensors.CONTACT_SLOTS, sensors.CONTACT_SIZE
        return self._sensor(sensors.CONTACTS, slots * size).reshape(-1, slots, size)

    @cached_property
    def place_sensors(self) -> NDArray[np.int64]:
        """`(F, 3)` addresses of where the bodies are that carry the fingertips; empty likewise."""
        return self._sensor(sensors.PLACE, 3)

    def _sensor(self, prefix: str, width: int) -> NDArray[np.int64]:
        kind, names = mujoco.mjtObj.mjOBJ_SENSOR, [f"{prefix}{i}" for i in range(len(self.file.fingertips))]
        ids = [mujoco.mj_name2id(self.model, kind, name) for name in names]
        start = [self.model.sensor_adr[sensor] for sensor in ids if sensor >= 0]
        return np.array(start, int).reshape(-1, 1) + np.arange(width)

    @cached_property
    def touch_sensors(self) -> NDArray[np.int64]:
        """`(R,)` addresses of the flags that tell whether a robot's links touch the object."""
        sensor_ids = [s for s in range(self.model.nsensor) if self.model.sensor(s).name.startswith(sensors.TOUCH)]
        return np.array([self.model.sensor(s).adr[0] for s in sensor_ids], int)

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the compiled model and the roles: names what was simulated, with labels or without."""
        model = (self.unlabelled or self).model
        buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, buffer)
        given = "".join(setting.model_dump_json() for setting in self.given_effects)
        return hashlib.sha256(buffer.tobytes() + (self.file.model_dump_json() + given).encode()).hexdigest()

    def group(self, joint: str) -> str:
        """Return the group of a joint: the one the scene names, else `slides` or `hinges`."""
        for name, members in self.file.groups.items():
            if joint in members:
                return name
        kind = self.model.jnt_type[self.model.joint(joint).id]
        return "slides" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "hinges"


def subtree(model: mujoco.MjModel, body: int) -> set[int]:
    """Return the ids of `body` and all bodies it carries."""
    bodies = {body}
    for child in range(body + 1, model.nbody):
        if model.body_parentid[child] in bodies:
            bodies.add(child)
    return bodies


def _colliding_geoms(model: mujoco.MjModel, bodies: set[int]) -> NDArray[np.int64]:
    """Return ids of the geoms of `bodies` that can collide."""
    touch = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return np.flatnonzero(np.isin(model.geom_bodyid, list(bodies)) & touch)


def _carrier(model: mujoco.MjModel, tip: str) -> int:
    """Return the body id of a fingertip, which may be a body or a geom (a body wins)."""
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip)
    return body if body >= 0 else int(model.geom_bodyid[model.geom(tip).id])


def load_scene(name: str | Path) -> Scene:
    """Return the scene of the library called `name`, or the one a `scene.yaml` describes.

    `SCENE+OBJECT` is that scene with another object in the place of its own: a registered one, or that of a folder.

    Raises
    ------
    SceneError
        When the model does not compile or lacks a name that the scene uses, or cannot hold the object.
    UsageError
        When the file is missing or not valid.
    DataError
        When it, the model or a file that the model names is a Git LFS pointer.
    """
    base, plus, object_name = str(name).rpartition(OBJECT_MARK)
    if not plus or Path(name).exists():
        return assemble(str(name), *_source(name))
    file, spec, policies = _source(base)
    replace_object(base, file, spec, named_object(object_name))
    return replace(assemble(str(name), file, spec, policies), has_other_object=True)


def _source(name: str | Path) -> tuple[SceneFile, mujoco.MjSpec, tuple[str, ...]]:
    """Return the roles of a scene, its model, and the policies that suit it."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml"):
        return (*_from_file(path), ())
    if str(name) not in SCENES:
        if path.suffix.lower() in _MODELS or path.exists():
            raise _no_scene(path)
        raise UnknownNameError("scene", str(name), SCENES.names(), Where(path="give a .yaml path for your own"))
    builtin = SCENES.load(str(name))
    return builtin.file, builtin.build(), builtin.policies


def _no_scene(path: Path) -> UsageError:
    """Return the error of a path that leads to a model, a folder or anything else but a scene file."""
    scene_path = (path if path.is_dir() else path.parent) / "scene.yaml"
    ways = [f"give {scene_path}"] if scene_path.is_file() else []
    problem = "is a folder" if path.is_dir() else "is no scene file" if path.exists() else "does not exist"
    if path.is_file() and path.suffix.lower() in _MODELS:
        problem = "is a model, which does not say which part plays which role"
        ways.append(f"candata scene init {path}, then give the scene file that it writes")
    return UsageError(
        f"{path} {problem}",
        expected="a scene.yaml, or the name of a built-in scene",
        where=Where(path=str(path)),
        fix=", or: ".join(ways),
    )


def _from_file(path: Path) -> tuple[SceneFile, mujoco.MjSpec]:
    """Return the roles and the model of a `scene.yaml`."""
    if not path.is_file():
        raise UsageError(f"scene file {path} does not exist", where=Where(path=str(path)))
    file = SceneFile.parse(read_yaml(path), path)
    if isinstance(file.model, ArmWithHand):
        return file, compose(file.model.arm, file.model.hand, at=file.model.at, path=path)
    if file.model == "builtin" or (file.model in SCENES and not (path.parent / file.model).exists()):
        raise SceneError("a scene file names a model file", expected="an MJCF or URDF beside it", found=file.model)
    source = model_path(path, file.model)
    if not source.is_file():
        kind = kind_of(source)
        kind_found = f"is {kind}, no file" if kind else "does not exist"
        raise SceneError(f"model {file.model} {kind_found}", expected=str(source), where=Where(path=str(path)))
    return file, read_model(source)


def assemble(name: str, file: SceneFile, spec: mujoco.MjSpec, policies: tuple[str, ...] = ()) -> Scene:
    """Return the scene made of `spec` with the roles of `file`.

    Adds servos a URDF lacks and the fingertips' force sensors, lets the object's centre of mass move
    (`simple="false"`), and asks for dense solving, as MuJoCo 4.0.0 has a wrong sparse Newton factor (fixed in 4.0.1).

    Raises
    ------
    SceneError
        When a role names what the model lacks, or the model does not compile.
    """
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    check_roles(name, file, spec)
    if isinstance(file.actuators, dict):
        for joint, servo in file.actuators.items():
            _add_servo(spec, joint, servo)
    if file.object is not None:
        spec.body(file.object).simple = mujoco.mjtLimited.mjLIMITED_FALSE
        sensors.add_touch(spec, file)
    for index, tip in enumerate(file.fingertips):
        sensors.add_force(spec, file, index, tip)
    model = compile_model(spec, name)
    check_recorded(name, file, spec)
    check_rate(name, file, model)
    check_commands(name, model)
    return Scene(name, file, model, policies, spec=spec)


def _add_servo(spec: mujoco.MjSpec, joint: str, servo: Servo) -> None:
    """Add a position servo to a joint of a model without actuators."""
    actuator = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_position(kp=servo.kp, kv=servo.kv)
    if servo.limit is not None:
        actuator.forcelimited, actuator.forcerange = True, (-servo.limit, servo.limit)
