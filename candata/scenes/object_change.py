"""Another object in the place of a scene's own: it stands upright there, and touches what that touched."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import SceneError
from candata.rotation import multiply
from candata.scenes.contract import SceneObject
from candata.scenes.model_file import compile_model
from candata.scenes.object_body import TOUCHING_GROUP, add_shapes
from candata.schema.scene import SceneFile

#: What decides with which other geoms a geom collides, and how it then feels (MuJoCo XML reference, "body/geom").
_CONTACT = (
    *("contype", "conaffinity", "condim", "priority", "friction", "solref", "solimp", "solmix", "margin", "gap"),
)
#: Height above the support from which the new object is let down [m]: above any object in a hand.
ABOVE_M = 3.0
#: Headings that are tried. Chosen: a handle is turned out of the way of a finger in steps of 45 degrees.
HEADINGS = 8


def replace_object(name: str, file: SceneFile, spec: mujoco.MjSpec, scene_object: SceneObject) -> None:
    """Put an object in the place of the scene's own, in `spec`: on its support, mass centre above mass centre.

    It stands upright, turned about the vertical where a part of the robot is in its way; else in the resting pose with
    the least tilt for which there is room. The body keeps its name, so roles stay. Where geoms of the old object
    touched different things (a body that meets the fingers, a foot that meets the table), each piece of the new one is
    there once for each.

    Parameters
    ----------
    name : str
        Name of the scene, for errors.
    file : SceneFile
        Its roles.
    spec : mujoco.MjSpec
        Its model; changed.
    scene_object : SceneObject
        The object that comes in.

    Raises
    ------
    SceneError
        When the scene has no object or support, its object cannot be exchanged, as it carries other bodies or the model
        names its geoms, or there is no room for the new one.
    """
    body = _old_body(name, file, spec)
    model = compile_model(spec, name)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    place = data.xipos[model.body(body.name).id].copy()
    classes = list(dict.fromkeys(_contact_class(g) for g in body.geoms if g.contype or g.conaffinity))
    if not classes:
        raise SceneError(f"the object of scene {name} touches nothing", fix="let a geom of it collide")
    for geom in list(body.geoms):
        spec.delete(geom)
    body.explicitinertial, body.ipos = False, (np.nan, 0.0, 0.0)  # not defined: inertia is that of the geoms
    pieces = add_shapes(spec, body, scene_object, f"{file.object}_{scene_object.name}")
    for k, contact in enumerate(classes):
        for piece in pieces if k == 0 else [_copy(body, piece, k) for piece in pieces]:
            for attribute, value in zip(_CONTACT, contact, strict=True):
                setattr(piece, attribute, value)
    _stand(name, file, spec, body, scene_object, place)


def _old_body(name: str, file: SceneFile, spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Return the body of the scene's object, once it is known that another can take its place."""
    if file.object is None or file.support is None:
        missing = "object" if file.object is None else "support"
        raise SceneError(
            f"scene {name} cannot hold another object",
            expected="an object, and a support on which it stands",
            found=f"no {missing}",
            fix=f"name it in the scene file: `{missing}: ...`",
        )
    body = spec.body(file.object)
    if body is None:
        raise SceneError(f"scene {name} has no body {file.object}")
    geoms = {geom.name for geom in body.geoms if geom.name}
    if file.support in geoms or geoms & set(file.fingertips):
        problem = "its own geoms have roles"
    elif body.bodies:
        problem = f"it carries {body.bodies[0].name or 'another body'}"
    elif any({pair.geomname1, pair.geomname2} & geoms for pair in spec.pairs):
        problem = "contact pairs name its geoms"
    else:
        return body
    raise SceneError(
        f"the object of scene {name} cannot be exchanged",
        expected="one free body whose geoms nothing else names",
        found=problem,
        fix="make a scene for each object",
    )


def _contact_class(geom: mujoco.MjsGeom) -> tuple:
    """Return how a geom touches, as plain values that can be compared."""
    values = (getattr(geom, attribute) for attribute in _CONTACT)
    return tuple(tuple(v.tolist()) if isinstance(v, np.ndarray) else v for v in values)


def _copy(body: mujoco.MjsBody, piece: mujoco.MjsGeom, number: int) -> mujoco.MjsGeom:
    """Return a second geom of the same shape, without mass, that is not seen."""
    shape = {"type": piece.type, "size": piece.size, "pos": piece.pos, "quat": piece.quat, "meshname": piece.meshname}
    return body.add_geom(name=f"{piece.name}_{number}", mass=0, group=TOUCHING_GROUP, **shape)


def _stand(
    name: str,
    file: SceneFile,
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    scene_object: SceneObject,
    place: NDArray[np.float64],
) -> None:
    """Put the object on the support, its mass centre above `place (3,)` [m], as upright as the robot leaves room."""
    model = compile_model(spec, name)
    rests = sorted(scene_object.file.rests, key=lambda rest: rest.tilt_rad)
    attitudes = (multiply(turn, np.array(rest.quaternion)) for rest in rests for turn in _headings())
    poses = (_standing_pose(model, body.name, file.support, attitude, place) for attitude in attitudes)
    pose = next((pose for pose in poses if pose is not None), None)
    if pose is None:
        raise SceneError(
            f"object {scene_object.name} does not fit into scene {name}",
            expected="room for it where the object of the scene stands",
            found="a part of the robot in its place, however it rests",
            fix="leave it out, or hold the robot higher in the model",
        )
    body.pos, body.quat = pose[:3], pose[3:]
    at = int(model.jnt_qposadr[model.body_jntadr[model.body(body.name).id]])
    for key in spec.keys:
        qpos = list(key.qpos)
        qpos[at : at + 7] = pose.tolist() if qpos else []
        key.qpos = qpos


def _headings() -> NDArray[np.float64]:
    """Return quaternions `(HEADINGS, 4)` about the vertical; the first turns nothing."""
    half_angles = np.arange(HEADINGS) * np.pi / HEADINGS
    return np.stack([np.cos(half_angles), 0 * half_angles, 0 * half_angles, np.sin(half_angles)], axis=1)


def _standing_pose(
    model: mujoco.MjModel,
    body: str,
    support: str | None,
    attitude: NDArray[np.float64],
    place: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Return the pose `(7,)` of a body let down on the support; None where another moving body is in its place."""
    data = mujoco.MjData(model)
    body_id = model.body(body).id
    at = int(model.jnt_qposadr[model.body_jntadr[body_id]])
    data.qpos[at : at + 7] = (0, 0, place[2] + ABOVE_M, *attitude)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    data.qpos[at : at + 2] += place[:2] - data.xipos[body_id, :2]
    mujoco.mj_kinematics(model, data)
    touches = (model.geom_contype | model.geom_conaffinity) != 0
    pieces = np.flatnonzero((model.geom_bodyid == body_id) & touches)
    data.qpos[at + 2] -= _least_distance(model, data, pieces, np.array([model.geom(support).id]))
    mujoco.mj_kinematics(model, data)
    moving = np.flatnonzero((model.geom_bodyid != body_id) & (model.body_weldid[model.geom_bodyid] != 0))
    return None if _least_distance(model, data, pieces, moving) < 0 else np.array(data.qpos[at : at + 7])


def _least_distance(
    model: mujoco.MjModel, data: mujoco.MjData, first_geoms: NDArray[np.intp], second_geoms: NDArray[np.intp]
) -> float:
    """Return the least distance between two sets of geoms [m], negative where they overlap; at most twice `ABOVE_M`."""
    distance = 2 * ABOVE_M
    for first in first_geoms:
        for second in second_geoms:
            distance = min(distance, mujoco.mj_geomDistance(model, data, int(second), int(first), distance, None))
    return distance
