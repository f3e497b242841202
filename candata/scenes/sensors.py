"""The sensors that a scene adds to a model: forces and frames of fingertips, touches of the object, contacts."""

from __future__ import annotations

import mujoco

from candata.schema.scene import SceneFile

#: Beginnings of the sensors' names.
FORCE, INTERNAL, FRAME, TOUCH = "candata_force_", "candata_internal_", "candata_frame_", "candata_touch_"
COLLISION, CONTACTS, PLACE = "candata_collision_", "candata_contacts_", "candata_place_"
#: Numbers of a contact sensor (MuJoCo XML reference, sensor/contact): data bit of `force`, reduction `netforce`, slots.
_NET_FORCE = (2, 3, 1)
#: Alike: data bit of `found`, no reduction, one slot.
_IS_FOUND = (1, 0, 1)
#: Contacts of a fingertip that are told apart, the strongest first. Chosen: a box lies on a plane with four.
CONTACT_SLOTS = 6
#: Numbers of a contact: force (in the contact's frame), position, normal and first tangent (world), three each.
CONTACT_SIZE = 12
#: Alike: bits of force, position, normal and tangent; reduction `maxforce`; slots.
_EACH_CONTACT = (2 + 16 + 32 + 64, 2, CONTACT_SLOTS)


def add_force(spec: mujoco.MjSpec, file: SceneFile, index: int, tip: str) -> None:
    """Add the net force of all contacts on a fingertip (world frame) and the fingertip's frame.

    The fingertip is the second party of the sensor and the first is left open, so that the force is the one on it.
    """
    body, kind = spec.body(tip), _kind(spec, tip)
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
    carrier = _carrier(spec, tip)
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
            intprm=_IS_FOUND,
        )


def add_collision(spec: mujoco.MjSpec, file: SceneFile, index: int, tip: str) -> None:
    """Add the number of a fingertip's contacts with the object, whatever their force."""
    spec.add_sensor(
        name=f"{COLLISION}{index}",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=file.object,
        reftype=_kind(spec, tip),
        refname=tip,
        intprm=_IS_FOUND,
    )


def add_contacts(spec: mujoco.MjSpec, index: int, tip: str) -> None:
    """Add the strongest contacts of a fingertip, each by itself, and the place of the body that carries it."""
    spec.add_sensor(
        name=f"{CONTACTS}{index}",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_UNKNOWN,
        reftype=_kind(spec, tip),
        refname=tip,
        intprm=_EACH_CONTACT,
    )
    spec.add_sensor(
        name=f"{PLACE}{index}",
        type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=_carrier(spec, tip),
    )


def _kind(spec: mujoco.MjSpec, tip: str) -> mujoco.mjtObj:
    """Return whether a fingertip is a geom or a body (a body wins)."""
    return mujoco.mjtObj.mjOBJ_GEOM if spec.body(tip) is None else mujoco.mjtObj.mjOBJ_XBODY


def _carrier(spec: mujoco.MjSpec, tip: str) -> str:
    """Return the name of the body that carries a fingertip, which may be the fingertip itself."""
    return _name_of(spec, spec.geom(tip).parent) if spec.body(tip) is None else tip


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
