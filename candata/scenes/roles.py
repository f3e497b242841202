"""Roles of a scene as a plain value: what `candata scene show` prints."""

from __future__ import annotations

import mujoco

from candata.plugins import load, names
from candata.scenes.assemble import LIBRARY, Scene
from candata.schema.record import Record
from candata.schema.scene import Noise, SceneFile

_UNITS = {mujoco.mjtJoint.mjJNT_HINGE: "rad", mujoco.mjtJoint.mjJNT_SLIDE: "m"}


class JointRole(Record):
    """One joint: range in its unit (null: unlimited), and its servo (null: none) with gains and limit."""

    name: str
    type: str
    unit: str
    low: float | None = None
    high: float | None = None
    group: str
    actuator: str | None = None
    kp: float | None = None
    kv: float | None = None
    limit: float | None = None


class FingertipRole(Record):
    """One fingertip, the body that carries it, and what its forces are expressed in."""

    name: str
    body: str
    frame: str


class Roles(Record):
    """Everything a scene says of its parts; masses in kg, times in s."""

    name: str
    digest: str
    rate_hz: float
    timestep_s: float
    substeps: int
    integrator: str
    cone: str
    solver: str
    object: str | None
    object_mass_kg: float | None
    support: str | None
    joints: tuple[JointRole, ...]
    fingertips: tuple[FingertipRole, ...]
    noise: Noise | None
    policies: tuple[str, ...]


class SceneEntry(Record):
    """One line of the list of built-in scenes."""

    name: str
    about: str
    joints: int
    actuators: int
    fingertips: int
    object: str | None
    rate_hz: float


def builtin_scenes() -> tuple[SceneEntry, ...]:
    """Return the scenes of the library, by name; none is compiled."""
    return tuple(_entry(name) for name in names(LIBRARY))


def _entry(name: str) -> SceneEntry:
    """Return the line of one built-in scene."""
    scene = load(LIBRARY, "SCENE", name)
    file: SceneFile = scene.file
    return SceneEntry(
        name=name,
        about=scene.about,
        joints=len(file.joints),
        actuators=len(file.actuator_names),
        fingertips=len(file.fingertips),
        object=file.object,
        rate_hz=file.rate_hz,
    )


def roles(scene: Scene) -> Roles:
    """Return the roles of a scene, read from its compiled model."""
    model, file = scene.model, scene.file
    mass = None if scene.object_id is None else float(model.body_subtreemass[scene.object_id])
    return Roles(
        name=scene.name,
        digest=scene.digest,
        rate_hz=file.rate_hz,
        timestep_s=float(model.opt.timestep),
        substeps=scene.substeps,
        integrator=_word(mujoco.mjtIntegrator(model.opt.integrator)),
        cone=_word(mujoco.mjtCone(model.opt.cone)),
        solver=_word(mujoco.mjtSolver(model.opt.solver)),
        object=file.object,
        object_mass_kg=mass,
        support=file.support,
        joints=tuple(_joint(scene, name) for name in file.joints),
        fingertips=tuple(_fingertip(scene, i) for i in range(len(file.fingertips))),
        noise=file.noise,
        policies=scene.policies,
    )


def _word(member: object) -> str:
    """Return `elliptic` for `mjCONE_ELLIPTIC`."""
    return str(getattr(member, "name", member)).split("_", 1)[-1].lower()


def _joint(scene: Scene, name: str) -> JointRole:
    """Return the role of one joint."""
    model = scene.model
    joint = model.joint(name).id
    kind = mujoco.mjtJoint(model.jnt_type[joint])
    low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (None, None)
    return JointRole(
        name=name,
        type=_word(kind),
        unit=_UNITS.get(kind, "1"),
        low=low,
        high=high,
        group=scene.group(name),
        **_servo(scene, joint),
    )


def _servo(scene: Scene, joint: int) -> dict:
    """Return actuator, gains and limit of a joint; nothing for one that no actuator pulls."""
    model = scene.model
    for name, actuator in zip(scene.file.actuator_names, scene.actuator_ids.tolist(), strict=True):
        if joint in scene.levers.get(actuator, ()):
            limited = model.actuator_forcelimited[actuator]
            return {
                "actuator": name,
                "kp": float(scene.stiffness([actuator])[0]),
                "kv": float(0.0 - model.actuator_biasprm[actuator, 2]),
                "limit": float(model.actuator_forcerange[actuator, 1]) if limited else None,
            }
    return {}


def _fingertip(scene: Scene, index: int) -> FingertipRole:
    """Return the role of one fingertip."""
    body = scene.model.body(int(scene.fingertip_bodies[index])).name
    frames = scene.file.fingertip_frames
    frame = f"site {frames[index]}" if frames else f"body {body}"
    return FingertipRole(name=scene.file.fingertips[index], body=body, frame=frame)
