"""Roles of a scene as a plain value: what `candata scene show` prints."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco

from candata.scenes import chains
from candata.scenes.assemble import Scene
from candata.scenes.contract import SCENES, BuiltinScene
from candata.scenes.drives import drive_of, pulled_by
from candata.schema.record import ResultRecord
from candata.schema.scene import Noise

_UNITS = {mujoco.mjtJoint.mjJNT_HINGE: "rad", mujoco.mjtJoint.mjJNT_SLIDE: "m"}


class JointRole(ResultRecord):
    """One joint: range in its unit (null: unlimited), and the actuator that pulls it (null: none).

    `drive` is its kind, such as `position servo` or `torque motor`; `kp`, `kv` and `limit` are null where it has none,
    in `kp_unit`, `kv_unit` and `limit_unit`.
    """

    name: str
    type: str
    unit: str
    low: float | None = None
    high: float | None = None
    group: str
    actuator: str | None = None
    drive: str | None = None
    kp: float | None = None
    kp_unit: str | None = None
    kv: float | None = None
    kv_unit: str | None = None
    limit: float | None = None
    limit_unit: str | None = None


class FingertipRole(ResultRecord):
    """One fingertip, the body that carries it, and what its forces are expressed in."""

    name: str
    body: str
    frame: str


class Roles(ResultRecord):
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
    notes: tuple[str, ...] = ()


class SceneEntry(ResultRecord):
    """One line of the list of built-in scenes."""

    name: str
    about: str
    joints: int
    actuators: int
    fingertips: int
    object: str | None
    rate_hz: float


def builtin_scenes() -> tuple[SceneEntry, ...]:
    """Return the scenes that can be named, by name; none is compiled."""
    return tuple(_entry(name, scene) for name, scene in SCENES.load_all().items())


def _entry(name: str, scene: BuiltinScene) -> SceneEntry:
    """Return the line of one built-in scene."""
    file = scene.file
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
        notes=tuple(_notes(scene)),
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
        **_drive(scene, joint),
    )


def _drive(scene: Scene, joint: int) -> dict:
    """Return actuator, kind, gains and limit of a joint's drive; nothing for one that no actuator pulls."""
    model = scene.model
    for name, actuator in zip(scene.file.actuator_names, scene.actuator_ids.tolist(), strict=True):
        if joint in scene.levers.get(actuator, ()):
            drive, is_limited = drive_of(model, actuator), model.actuator_forcelimited[actuator]
            return {
                "actuator": name,
                "drive": drive.kind,
                "kp": drive.kp,
                "kp_unit": drive.units.kp,
                "kv": drive.kv,
                "kv_unit": drive.units.kv,
                "limit": float(model.actuator_forcerange[actuator, 1]) if is_limited else None,
                "limit_unit": drive.units.effort,
            }
    return {}


def _fingertip(scene: Scene, index: int) -> FingertipRole:
    """Return the role of one fingertip."""
    body = scene.model.body(int(scene.fingertip_bodies[index])).name
    frames = scene.file.fingertip_frames
    frame = f"site {frames[index]}" if frames else f"body {body}"
    return FingertipRole(name=scene.file.fingertips[index], body=body, frame=frame)


def _notes(scene: Scene) -> Iterator[str]:
    """Yield what a user may not have meant: what is commanded or moves, and is neither recorded nor compared."""
    model, joints = scene.model, set(scene.joint_ids.tolist())
    for actuator in scene.actuator_ids.tolist():
        if not joints.intersection(scene.levers.get(actuator, {})):
            kind, target_text = drive_of(model, actuator).kind, pulled_by(model, actuator)
            yield f"actuator {model.actuator(actuator).name}, a {kind}, pulls {target_text}, which is not recorded"
    unlisted_names = [
        model.actuator(a).name or f"number {a}" for a in range(model.nactuator) if a not in scene.actuator_ids
    ]
    if unlisted_names:
        yield f"actuators that `actuators` does not list get the command 0: {', '.join(unlisted_names)}"
    for body in sorted({int(model.body_rootid[model.jnt_bodyid[j]]) for j in joints}):
        if body != scene.object_id and chains.floats(model, body):
            name = model.body(body).name or f"number {body}"
            yield f"body {name}, which carries joints, floats free and is not the object: its place is not recorded"
