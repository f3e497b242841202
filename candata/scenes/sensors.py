"""The sensors that a scene adds to a model: forces and frames of fingertips, and touches of the object."""

from __future__ import annotations

import mujoco

from candata.schema.scene import SceneFile

#: Beginnings of the sensors' names.
FORCE, INTERNAL, FRAME, TOUCH = "candata_force_", "candata_internal_", "candata_frame_", "candata_touch_"
#: Numbers of a contact sensor (MuJoCo XML reference, sensor/contact): data bit of `force`, reduction `netforce`, slots.
_NET_FORCE = (2, 3, 1)


def add_force(spec: mujoco.MjSpec, file: SceneFile, index: int, tip: str) -> None:
    """Add the net force of all contacts on a fingertip (world frame) and the fingertip's frame.

    The fingertip is the second party of the sensor and the first is left open, so that the force is the one on it.
    """
    body = spec.body(tip)
    kind = mujoco.mjtObj.mjOBJ_GEOM if body is None else mujoco.mjtObj.mjOBJ_XBODY
    spec.add_sensor(
        name=f"{FORCE}{index}",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_UNKNOWN,
        reftype=kind,
        refname=tip,
        intprm=_NET_FORCE,
    )
    if body is not None and body.bodies:
        spec.add_sensor(
            name=f"{INTERNAL}{index}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=kind,
            objname=tip,
            reftype=kind,
            refname=tip,
            intprm=_NET_FORCE,
        )
    carrier = _name_of(spec, spec.geom(tip).parent) if body is None else tip
    frame = (
        (mujoco.mjtObj.mjOBJ_SITE, file.fingertip_frames[index])
        if file.fingertip_frames
        else (mujoco.mjtObj.mjOBJ_XBODY, carrier)
    )
    spec.add_sensor(name=f"{FRAME}{index}", type=mujoco.mjtSensor.mjSENS_FRAMEQUAT, objtype=frame[0], objname=frame[1])


def add_touch(spec: mujoco.MjSpec, file: SceneFile) -> None:
    """Add the flags that tell whether a robot's links touch the object, one for each of its trees of links."""
    for index, root in enumerate(sorted({_name_of(spec, _root(spec.joint(j).parent)) for j in file.joints})):
        spec.add_sensor(
            name=f"{TOUCH}{index}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=file.object,
            reftype=mujoco.mjtObj.mjOBJ_XBODY,
            refname=root,
            intprm=(1, 0, 1),
        )


def _name_of(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> str:
    """Return the name of a body; one that has none gets one, as a sensor can only refer to a name."""
    if not body.name:
        body.name = f"candata_body_{sum(bool(b.name) for b in spec.bodies)}"
    return str(body.name)


def _root(body: mujoco.MjsBody) -> mujoco.MjsBody:
    """Return the ancestor of `body` that stands on the world."""
    while body.parent.name != "world":
        body = body.parent
    return body
