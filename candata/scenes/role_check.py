"""Checks that the parts of a model can play the roles that a scene gives them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import mujoco

from candata.errors import MOST_NAMES, SceneError, UnknownNameError, Where
from candata.schema.scene import SceneFile

_HINGE, _SLIDE, _FREE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_FREE
_BY_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
#: Name of an effect's element that is all fingertips together.
_ALL_TIPS = "fingertips"


def check_roles(scene: str, file: SceneFile, spec: mujoco.MjSpec) -> None:
    """Return nothing when every role of a scene names a part of the model that can play it.

    Raises
    ------
    SceneError
        When a part is named twice, is of a kind that cannot play its role, or roles contradict one another.
    UnknownNameError
        When the model has no part of a name.
    """
    _check_object(scene, file, spec)
    _check_joints(scene, file, spec)
    _check_actuators(scene, file, spec)
    _check_fingertips(scene, file, spec)
    _check_support(scene, file, spec)
    _check_groups(scene, file)
    noise = file.noise.joint_position if file.noise else 0.0
    if isinstance(noise, tuple) and len(noise) != len(file.joints):
        raise SceneError(
            f"scene {scene}: noise.joint_position is not one number a joint",
            expected=f"one number, or {len(file.joints)}",
            found=f"{len(noise)} numbers",
            where=Where(path=scene),
        )


def _free_instead(body: mujoco.MjsBody, free: Sequence[str]) -> str:
    """Return what to do about an object that is not free."""
    carrier = next((parent.name for parent in _carrying_bodies(body) if parent.name in free), None)
    if carrier is not None:
        return f"name the free body that carries it: `object: {carrier}`"
    ways = [f"name a free body: {_name_list(free)}"] if free else []
    if body.name != "world":
        move = "" if body.parent.name == "world" else f"move {body.name} to the top level of <worldbody>, and "
        ways.append(f"{move}add <freejoint/> to {body.name}{' in place of its joints' if len(body.joints) else ''}")
    return "; or ".join(ways) or "give the body that is tracked a <freejoint/>"


def check_recorded(scene: str, file: SceneFile, spec: mujoco.MjSpec) -> None:
    """Return nothing when something is recorded of a scene that can be compared.

    Raises
    ------
    SceneError
        When it has neither joints nor an object.
    """
    if file.joints or file.object is not None:
        return
    joints, free = scalar_joints(spec), free_bodies(spec)
    fixes = [f"list those whose positions are recorded: `joints: [{_name_list(joints)}]`"] if joints else []
    fixes += [f"name what is tracked: `object: {free[0]}`"] if free else []
    raise SceneError(
        f"scene {scene} has {'actuators but ' if file.actuator_names else ''}neither joints nor an object",
        expected="`joints`, `object`, or both: a recording needs joint positions or the pose of an object",
        found=f"the model has hinge and slide joints {_name_list(joints)}; free bodies {_name_list(free)}",
        where=Where(path=scene),
        fix=", or ".join(fixes) or "name a joint of the model, or give a body a <freejoint/>",
    )


def _check_object(scene: str, file: SceneFile, spec: mujoco.MjSpec) -> None:
    """Refuse an object that is not free, or that touches nothing."""
    if file.object is None:
        return
    free = free_bodies(spec)
    body = spec.body(file.object)
    if body is None:
        _refuse_other_kind(scene, "object", file.object, spec, f"a body with one free joint: {_name_list(free)}")
        raise UnknownNameError(f"object of scene {scene}:", file.object, free or _names(spec.bodies), Where(path=scene))
    if file.object not in free:
        raise SceneError(
            f"object {body.name} of scene {scene} is not free",
            expected="a body with one free joint",
            found=_holder_text(body),
            where=Where(path=scene),
            fix=_free_instead(body, free),
        )
    if not any(_collides(geom) for part in _tree(body) for geom in part.geoms):
        raise SceneError(
            f"object {body.name} of scene {scene} has no geom that collides, so nothing can touch it",
            expected="a geom whose contype or conaffinity is not 0",
            where=Where(path=scene),
            fix=f"give {body.name} a geom that collides, or leave `object` out",
        )


def _check_joints(scene: str, file: SceneFile, spec: mujoco.MjSpec) -> None:
    """Refuse joints that have no single position, or that are named twice."""
    joint_names = scalar_joints(spec)
    for name in file.joints:
        joint = spec.joint(name)
        if joint is None:
            _refuse_other_kind(
                scene, "joint", name, spec, f"one of the hinge and slide joints {_name_list(joint_names)}"
            )
            raise UnknownNameError(f"joint of scene {scene}:", name, joint_names, Where(path=scene))
        if joint.type in (_HINGE, _SLIDE):
            continue
        free, body = joint.type == _FREE, joint.parent.name
        as_object = f"; if the pose of {body} is recorded, name it: `object: {body}`" if body != file.object else ""
        raise SceneError(
            f"joint {name} of scene {scene} is {_kind(joint)}, which has no single position",
            expected=f"hinge and slide joints: {_name_list(joint_names)}",
            found=f"{_kind(joint)} of body {body}: {'seven numbers' if free else 'four numbers, a quaternion'}",
            where=Where(path=scene),
            fix=f"leave {name} out of `joints`"
            + (as_object if free else "; where its angles are recorded, model it as three hinges"),
        )
    _refuse_twice(scene, "joint", file.joints)


def _check_actuators(scene: str, file: SceneFile, spec: mujoco.MjSpec) -> None:
    """Refuse actuators that are named twice, and servos on joints that cannot have them or have a servo already.

    An actuator may drive a joint that is not listed: its commands are known, and its start is estimated.
    """
    actuator_names = _names(spec.actuators)
    if not isinstance(file.actuators, dict):
        for name in file.actuators:
            if name not in actuator_names:
                driver_names = [a.name for a in spec.actuators if _drives(a, name) and a.name]
                expected_text = f"one of the actuators {_name_list(driver_names or actuator_names)}"
                _refuse_other_kind(scene, "actuator", name, spec, expected_text)
                raise UnknownNameError(f"actuator of scene {scene}:", name, actuator_names, Where(path=scene))
        _refuse_twice(scene, "actuator", file.actuators)
        return
    joints = scalar_joints(spec)
    for name in file.actuators:
        if spec.joint(name) is not None and name not in joints:
            raise SceneError(
                f"actuator {name} of scene {scene} would be a servo of {_kind(spec.joint(name))}",
                expected=f"gains of hinge and slide joints: {_name_list(joints)}",
                found=_kind(spec.joint(name)),
                where=Where(path=scene),
                fix=f"leave {name} out of `actuators`",
            )
        if name not in joints:
            expected_text = f"gains are given to joints: {_name_list(joints)}"
            _refuse_other_kind(scene, "actuator", name, spec, expected_text)
            raise UnknownNameError(f"actuator of scene {scene}:", name, joints, Where(path=scene))
        model_actuator = next(
            (a for a in spec.actuators if a.name == name or (_drives(a, name) and _is_servo(a))), None
        )
        if model_actuator is not None:
            raise SceneError(
                f"actuator {name} of scene {scene} would be a second one: the model drives that joint",
                expected="gains only of joints that the model does not drive",
                found=f"actuator {model_actuator.name or 'without a name'} on {model_actuator.target}",
                where=Where(path=scene),
                fix=f"list the model's own actuators by name: `actuators: [{_name_list(actuator_names)}]`",
            )


def _check_fingertips(scene: str, file: SceneFile, spec: mujoco.MjSpec) -> None:
    """Refuse fingertips that feel nothing, or what others feel, and frames that do not match."""
    of_object = set() if file.object is None or _carries(spec, file.object, file) else _tree_names(spec, file.object)
    bodies, geoms = _names(spec.bodies), _names(spec.geoms)
    for name in file.fingertips:
        if name not in (*bodies, *geoms):
            _refuse_other_kind(scene, "fingertip", name, spec, "a body or a geom that collides")
            raise UnknownNameError(f"fingertip of scene {scene}:", name, {*bodies, *geoms}, Where(path=scene))
        body = spec.body(name) or spec.geom(name).parent
        tip_geoms = [geom for part in _tree(body) for geom in part.geoms] if name in bodies else [spec.geom(name)]
        problem = fix = ""
        if body.name == "world":
            problem, fix = (
                "is a part of the world, which no finger carries",
                "name a body of the hand, or a geom of one",
            )
        elif body.name in of_object:
            problem, fix = f"is a part of the object {file.object}", "name a body of the hand, or a geom of one"
        elif not any(_touches(spec, geom) for geom in tip_geoms):
            colliding_carriers = [
                part.name for part in _carrying_bodies(body) if part.name and any(_collides(g) for g in part.geoms)
            ]
            problem = "has no geom that collides: its force would always be zero"
            fix = (
                f"name what touches, such as {colliding_carriers[0]}"
                if colliding_carriers
                else "name a body or a geom that collides"
            )
        if problem:
            part_text = f"body {name}" if name in bodies else f"geom {name} of body {body.name or 'without a name'}"
            raise SceneError(
                f"fingertip {name} of scene {scene} {problem}",
                expected="a body or a geom of the hand that collides",
                found=part_text,
                where=Where(path=scene),
                fix=fix,
            )
    _refuse_twice(scene, "fingertip", file.fingertips)
    sites = _names(spec.sites)
    for name in file.fingertip_frames or ():
        if name not in sites:
            _refuse_other_kind(scene, "fingertip frame", name, spec, f"a site: {_name_list(sites)}")
            raise UnknownNameError(f"fingertip frame of scene {scene}:", name, sites, Where(path=scene))
    if file.fingertip_frames is not None and len(file.fingertip_frames) != len(file.fingertips):
        raise SceneError(
            f"scene {scene} needs one frame a fingertip",
            expected=f"{len(file.fingertips)} fingertip_frames",
            found=str(len(file.fingertip_frames)),
        )


def _check_support(scene: str, file: SceneFile, spec: mujoco.MjSpec) -> None:
    """Refuse a support on which the object cannot rest."""
    if file.support is None:
        return
    geom = spec.geom(file.support)
    if geom is None:
        body = spec.body(file.support)
        body_geoms = [g.name for g in body.geoms if g.name and _collides(g)] if body is not None else []
        _refuse_other_kind(
            scene, "support", file.support, spec, f"a geom: {_name_list(body_geoms or _names(spec.geoms))}"
        )
        raise UnknownNameError(f"support of scene {scene}:", file.support, _names(spec.geoms), Where(path=scene))
    is_of_object = file.object is not None and geom.parent.name in _tree_names(spec, file.object)
    if is_of_object or not _touches(spec, geom):
        problem = (
            f"is a part of the object {file.object}" if is_of_object else "does not collide: nothing can rest on it"
        )
        raise SceneError(
            f"support {file.support} of scene {scene} {problem}",
            expected="the geom that the object rests on",
            where=Where(path=scene),
            fix="name the geom of the table or the floor that collides, or leave `support` out",
        )


def _check_groups(scene: str, file: SceneFile) -> None:
    """Refuse groups that reports could not tell from other elements, that are empty, or hold what is not listed."""
    for group, members in file.groups.items():
        for member in members:
            if member not in file.joints:
                raise UnknownNameError(
                    f"member of group {group} of scene {scene}:", member, file.joints, Where(path=scene)
                )
        if group in (*file.joints, *file.fingertips, _ALL_TIPS):
            raise SceneError(
                f"scene {scene}: group {group} bears the name of a joint or fingertip",
                expected="a name of its own: reports tell one from the other by it",
                found=group,
            )
        if not members:
            raise SceneError(
                f"scene {scene}: group {group} is empty",
                expected="joints of `joints`",
                where=Where(path=scene),
                fix="list its joints, or remove it",
            )
        _refuse_twice(scene, "joint", members, f"group {group} of ")


def _refuse_twice(scene: str, role: str, names: Sequence[str], group: str = "") -> None:
    """Refuse a name that stands twice in a role."""
    for name, count in Counter(names).items():
        if count > 1:
            places = ", ".join(str(i + 1) for i, n in enumerate(names) if n == name)
            raise SceneError(
                f"{role} {name} of {group}scene {scene} is named {'twice' if count == 2 else f'{count} times'}",
                expected="each one once: its place says which column it is",
                found=f"at places {places}",
                where=Where(path=scene),
                fix="remove all but one of them",
            )


def _refuse_other_kind(scene: str, role: str, name: str, spec: mujoco.MjSpec, expected_text: str) -> None:
    """Refuse a name that the model has, but for a part of another kind than the role takes."""
    part_text = next(_parts_called(name, spec), None)
    if part_text is not None:
        raise SceneError(
            f"{role} {name} of scene {scene} is {part_text}",
            expected=expected_text,
            found=part_text,
            where=Where(path=scene),
        )


def _parts_called(name: str, spec: mujoco.MjSpec) -> Iterator[str]:
    """Yield descriptions of the parts of a model that bear a name."""
    if (body := spec.body(name)) is not None:
        yield f"a body, with geoms {_name_list(_names(body.geoms))}"
    for kind in ("joint", "geom", "site"):
        if (part := getattr(spec, kind)(name)) is not None:
            kind_text = _kind(part) if kind == "joint" else f"a {kind}"
            yield f"{kind_text} of body {part.parent.name or 'without a name'}"
    if (actuator := spec.actuator(name)) is not None:
        yield f"an actuator on {actuator.target}"
    if spec.tendon(name) is not None:
        yield "a tendon"


def scalar_joints(spec: mujoco.MjSpec) -> list[str]:
    """Return the names of the joints that have one position each: hinges and slides."""
    return [joint.name for joint in spec.joints if joint.name and joint.type in (_HINGE, _SLIDE)]


def free_bodies(spec: mujoco.MjSpec) -> list[str]:
    """Return the names of the bodies that have one joint, a free one."""
    free = (b for b in spec.bodies if len(b.joints) == 1 and b.joints[0].type == _FREE)
    return [body.name for body in free if body.name]


def _kind(joint: mujoco.MjsJoint) -> str:
    """Return `a ball joint` for such a joint."""
    return f"a {mujoco.mjtJoint(joint.type).name.removeprefix('mjJNT_').lower()} joint"


def _holder_text(body: mujoco.MjsBody) -> str:
    """Return a description of what holds a body."""
    if body.name == "world":
        return "the world itself, which does not move"
    if not len(body.joints):
        return f"no joint: {body.name} is fixed to {body.parent.name or 'its parent'}"
    return " and ".join(f"{_kind(joint)}{f' {joint.name}' if joint.name else ''}" for joint in body.joints)


def _carrying_bodies(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    """Yield the bodies that carry a body, the nearest first, without the world."""
    while (body := body.parent) is not None and body.name != "world":
        yield body


def _tree(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    """Yield a body and all that it carries."""
    queue = [body]
    while queue:
        queue += queue[0].bodies
        yield queue.pop(0)


def _tree_names(spec: mujoco.MjSpec, body: str) -> set[str]:
    """Return the names of a body and of all that it carries."""
    return set(_names(_tree(spec.body(body))))


def _carries(spec: mujoco.MjSpec, body: str, file: SceneFile) -> bool:
    """Tell whether a body carries a listed joint: the object is the robot's own floating base."""
    carried_joints = {joint.name for part in _tree(spec.body(body)) for joint in part.joints}
    return bool(carried_joints.intersection(file.joints))


def _collides(geom: mujoco.MjsGeom) -> bool:
    """Tell whether a geom's bit masks let it touch anything."""
    return bool(geom.contype or geom.conaffinity)


def _touches(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Tell whether a geom can touch anything, by its bit masks or in an explicit pair."""
    return _collides(geom) or bool(geom.name and any(geom.name in (p.geomname1, p.geomname2) for p in spec.pairs))


def _drives(actuator: mujoco.MjsActuator, joint: str) -> bool:
    """Tell whether an actuator drives a joint directly."""
    return bool(actuator.target == joint and actuator.trntype in _BY_JOINT)


def _is_servo(actuator: mujoco.MjsActuator) -> bool:
    """Tell whether an actuator holds a position or a speed by itself."""
    return bool(actuator.biastype != mujoco.mjtBias.mjBIAS_NONE and any(actuator.biasprm[1:3]))


def _names(parts: Iterable) -> list[str]:
    """Return the names of those parts of a spec that have one."""
    return [part.name for part in parts if part.name]


def _name_list(names: Sequence[str]) -> str:
    """Return names as one text; only the first ones of very many."""
    more_text = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more_text if names else "(none)"
