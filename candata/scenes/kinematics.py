"""Kinematics of a scene's hand, read off its model."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.scenes.assemble import Scene
from candata.scenes.traits import support_height
from candata.schema.kinematics import HandKinematics, JointScrew, TipPoint, Vector

_ONE_AXIS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


def hand_kinematics(scene: Scene) -> HandKinematics | None:
    """Return how the joints of a scene move its fingertips.

    None where `joint_position` does not decide where they are: without fingertips, or where a free, ball or mocap body,
    or a joint that is neither listed nor coupled to a listed one, carries them.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_kinematics(model, data)
    sources = _sources(scene)
    carriers = [_carrying_joints(model, int(body)) for body in scene.fingertip_bodies]
    if not carriers or any(joints is None for joints in carriers):
        return None
    moving_joints = sorted({joint for joints in carriers if joints for joint in joints})
    if any(joint not in sources or model.jnt_type[joint] not in _ONE_AXIS for joint in moving_joints):
        return None
    number = {joint: i for i, joint in enumerate(moving_joints)}
    screws = []
    for joint in moving_joints:
        before = _carrying_joints(model, int(model.jnt_bodyid[joint])) or []
        earlier = [other for other in before if other < joint]
        source, gain, offset = sources[joint]
        screws.append(
            JointScrew(
                parent=number[max(earlier)] if earlier else -1,
                axis=_vector(data.xaxis[joint]),
                anchor_m=_vector(data.xanchor[joint]),
                slides=bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE),
                joint=source,
                gain=gain,
                offset=offset,
            )
        )
    tips = tuple(
        _tip(scene, data, index, number[max(joints)] if joints else -1) for index, joints in enumerate(carriers)
    )
    return HandKinematics(
        screws=tuple(screws),
        tips=tips,
        driven_joints=_driven_joints(scene),
        support_height_m=None if scene.file.support is None else support_height(scene),
    )


def _sources(scene: Scene) -> dict[int, tuple[int, float, float]]:
    """Return for each joint id the reading that moves it, and gain and offset: its own, or that of a coupled joint.

    A coupling is y - y0 = a0 + a1 (x - x0) about the references; its higher terms are left out.
    Source: MuJoCo XML reference, "equality/joint".
    """
    model, listed = scene.model, {int(joint): i for i, joint in enumerate(scene.joint_ids)}
    reference = {joint: float(model.qpos0[model.jnt_qposadr[joint]]) for joint in range(model.njnt)}
    sources = {joint: (i, 1.0, -reference[joint]) for joint, i in listed.items()}
    for k in np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 > 0)):
        follower, leader = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if follower not in listed and leader in listed:
            constant, slope = map(float, model.eq_data[k, :2])
            sources[follower] = (listed[leader], slope, constant - slope * reference[leader])
    return sources


def _carrying_joints(model: mujoco.MjModel, body: int) -> list[int] | None:
    """Return the ids of the joints between a body and the world, ascending; None where a mocap body carries it."""
    joints: list[int] = []
    while body:
        if model.body_mocapid[body] >= 0:
            return None
        start = int(model.body_jntadr[body])
        joints += range(start, start + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return sorted(joints)


def _tip(scene: Scene, data: mujoco.MjData, index: int, carrier: int) -> TipPoint:
    """Return the ball at the end of a fingertip's longest reach: as wide as its geom is thin."""
    model, root = scene.model, data.xpos[scene.fingertip_bodies[index]]
    balls = []
    for geom in scene.fingertip_geoms[index]:
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        radius, longest = float(half.min()), int(half.argmax())
        for sign in (-1, 1):
            end = centre + sign * (half[longest] - radius) * np.eye(3)[longest]
            balls.append((data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ end, radius))
    point, radius = max(balls, key=lambda ball: float(np.linalg.norm(ball[0] - root)))
    return TipPoint(carrier=carrier, centre_m=_vector(point), radius_m=radius)


def _driven_joints(scene: Scene) -> tuple[int, ...]:
    """Return the index into `joint_position` of the joint each actuator drives; -1 where it drives no listed one."""
    listed = {int(joint): i for i, joint in enumerate(scene.joint_ids)}
    return tuple(listed.get(scene.driven_joints.get(int(actuator), -1), -1) for actuator in scene.actuator_ids)


def _vector(values: np.ndarray) -> Vector:
    """Return three numbers."""
    x, y, z = map(float, values)
    return x, y, z
