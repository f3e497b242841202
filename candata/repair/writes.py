"""From the numbers that an edit changed to the attributes of MJCF that say the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from candata.errors import SceneError
from candata.repair.elements import Key, locate_elements
from candata.repair.fields import DIRECT_FIELDS, INERTIA, OPTIONS, WORDS, Array, differences, joint_of, words
from candata.repair.markup import Edit, Node, at
from candata.scenes.motors import KD, KP, SLEW, VOLTAGE, is_motor

Attributes = dict[str, str | None]
#: What an inertial element may say instead of `quat` and `diaginertia`.
_OTHER_INERTIA = ("fullinertia", "axisangle", "euler", "xyaxes", "zaxis")
#: Attributes of servo shortcuts that `general` lacks.
_SHORTCUTS = ("kp", "kv", "dampratio", "timeconst", "area", "diameter", "bias")
#: Attributes of other actuators that `dcmotor` lacks.
_GENERAL_ONLY = (
    *("gaintype", "biastype", "dyntype", "gainprm", "biasprm", "dynprm"),
    *("actdim", "actlimited", "actrange", "actearly", "forcelimited", "forcerange", "inheritrange"),
)
_SERVO_INPUT = {"position": "pos", "velocity": "vel", "intvelocity": "vel"}
_GAINS = ("fixed", "affine", "muscle")
_BIASES = ("none", "affine", "muscle")
_DYNAMICS = ("none", "integrator", "filter", "filterexact", "muscle")
#: Index of the number of a size that is half the length, by shape that may be given by its ends.
_HALF_LENGTH_INDEX = {
    mujoco.mjtGeom.mjGEOM_CAPSULE: 1,
    mujoco.mjtGeom.mjGEOM_CYLINDER: 1,
    mujoco.mjtGeom.mjGEOM_BOX: 2,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: 2,
}
#: How many numbers a shape's size has.
_SIZES = {mujoco.mjtGeom.mjGEOM_SPHERE: 1, mujoco.mjtGeom.mjGEOM_CAPSULE: 2, mujoco.mjtGeom.mjGEOM_CYLINDER: 2}


@dataclass(frozen=True)
class _Change:
    """The model as it is and as it shall be, the spec of the text, and the element of each object in it."""

    source: mujoco.MjModel
    target: mujoco.MjModel
    spec: mujoco.MjSpec
    root: Node
    nodes: Mapping[Key, Node]


def edits(source: mujoco.MjModel, target: mujoco.MjModel, spec: mujoco.MjSpec, root: Node) -> list[Edit]:
    """Return the edits of an MJCF text that turn its compiled model `source` into `target`.

    Parameters
    ----------
    source, target : mujoco.MjModel
        As compiled from the text, and as edited by effects.
    spec : mujoco.MjSpec
        The text, compiled.
    root : Node
        The text.

    Raises
    ------
    SceneError
        When an element that changes is not to be found in the text.
    """
    change = _Change(source, target, spec, root, locate_elements(spec, root))
    changed_rows = {d.field: d.ids for d in differences(source, target)}
    attributes: dict[Key, Attributes] = {}
    for name, (kind, attribute) in DIRECT_FIELDS.items():
        for i in changed_rows.get(name, ()):
            key = (kind, joint_of(source, name, i) if kind == "joint" else i)
            attributes.setdefault(key, {})[attribute] = words(_row(target, name, i))
    _springs(change, changed_rows, attributes)
    for i in changed_rows.get("actuator_forcelimited", ()):
        attributes.setdefault(("actuator", i), {})["forcelimited"] = str(bool(target.actuator_forcelimited[i])).lower()
    touched_bodies = _geometry(change, changed_rows, attributes)
    out = [Edit(_node(change, key), values) for key, values in attributes.items() if key[0] != "actuator"]
    out += _servos(change, changed_rows, attributes)
    bodies = {i for name in INERTIA for i in changed_rows.get(name, ())} | touched_bodies
    out += [
        _inertial(change, changed_rows, i) for i in sorted(bodies) if source.body_weldid[i] and source.body_mass[i] > 0
    ]
    return out + _options(change, [name for name in OPTIONS if name in changed_rows])


def _row(model: mujoco.MjModel, field: str, index: int) -> Array:
    """Return one row of an array."""
    return np.atleast_1d(np.asarray(getattr(model, field)[index], float))


def _node(change: _Change, key: Key) -> Node:
    """Return the element of an object.

    Raises
    ------
    SceneError
        When the text does not say which it is, as where elements are replicated.
    """
    if key not in change.nodes:
        raise SceneError(
            f"{key[0]} {key[1]} has no element of its own in {change.root.file.name}",
            where=at(change.root),
        )
    return change.nodes[key]


def _springs(change: _Change, changed_rows: Mapping[str, tuple[int, ...]], attributes: dict[Key, Attributes]) -> None:
    """Add rest angles that change; spell out stiffness and damping that are given as time constant and ratio."""
    target = change.target
    for joint in change.spec.joints:
        address = int(target.jnt_qposadr[joint.id])
        if address in changed_rows.get("qpos_spring", ()):
            is_in_degrees = change.spec.compiler.degree and target.jnt_type[joint.id] == mujoco.mjtJoint.mjJNT_HINGE
            rest = float(target.qpos_spring[address])
            rest_words = words(float(np.degrees(rest)) if is_in_degrees else rest)
            attributes.setdefault(("joint", joint.id), {})["springref"] = rest_words
        values = attributes.get(("joint", joint.id), {})
        if np.any(joint.springdamper) and ("damping" in values or "stiffness" in values):
            damping = float(target.dof_damping[target.jnt_dofadr[joint.id]])
            stiffness = float(target.jnt_stiffness[joint.id])
            values |= {"springdamper": "0 0", "stiffness": words(stiffness), "damping": words(damping)}


def _geometry(
    change: _Change, changed_rows: Mapping[str, tuple[int, ...]], attributes: dict[Key, Attributes]
) -> set[int]:
    """Add places and sizes that change; return the bodies whose inertia would follow them."""
    source, target = change.source, change.target
    scales = _mesh_scales(change) if "mesh_vert" in changed_rows else {}
    for mesh in change.spec.meshes:
        if mesh.id in scales:
            attributes.setdefault(("mesh", mesh.id), {})["scale"] = words(scales[mesh.id] * np.array(mesh.scale))
    geom_ids = set(changed_rows.get("geom_pos", ())) | set(changed_rows.get("geom_size", ()))
    for geom in change.spec.geoms:
        if geom.id in geom_ids:
            values = attributes.setdefault(("geom", geom.id), {})
            values |= _placement(change, geom, scales.get(int(source.geom_dataid[geom.id])))
    for kind, elements in (("site", change.spec.sites), ("body", change.spec.bodies)):
        for element in elements:
            if element.id in changed_rows.get(f"{kind}_pos", ()):
                shift = _row(target, f"{kind}_pos", element.id) - _row(source, f"{kind}_pos", element.id)
                attributes.setdefault((kind, element.id), {})["pos"] = words(np.array(element.pos) + shift)
    return {int(source.geom_bodyid[g]) for g in geom_ids}


def _mesh_scales(change: _Change) -> dict[int, float]:
    """Return by how much each mesh that changes grows, read off the geoms that show it."""
    source, target = change.source, change.target
    geom_ids = np.flatnonzero(
        (source.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (source.geom_size != target.geom_size).any(1)
    )
    return {int(source.geom_dataid[g]): float(target.geom_size[g].max() / source.geom_size[g].max()) for g in geom_ids}


def _placement(change: _Change, geom: mujoco.MjsGeom, scale: float | None) -> Attributes:
    """Return the place and size of one geom in the words of its text: ends, or position and size."""
    source, target, i = change.source, change.target, geom.id
    if scale is not None:
        return {"pos": words(scale * np.array(geom.pos))}
    size = words(target.geom_size[i][: _SIZES.get(geom.type, 3)])
    size_attributes: Attributes = {"size": size} if (source.geom_size[i] != target.geom_size[i]).any() else {}
    ends = np.array(geom.fromto)
    shift = target.geom_pos[i] - source.geom_pos[i]
    if not np.isfinite(ends).all():
        return size_attributes | ({"pos": words(np.array(geom.pos) + shift)} if shift.any() else {})
    length_index = _HALF_LENGTH_INDEX[geom.type]
    stretch = target.geom_size[i][length_index] / source.geom_size[i][length_index]
    centre, half_axis = (ends[:3] + ends[3:]) / 2, (ends[3:] - ends[:3]) / 2
    new_ends = np.concatenate([centre + shift - stretch * half_axis, centre + shift + stretch * half_axis])
    return {"fromto": words(new_ends), **size_attributes}


def _inertial(change: _Change, changed_rows: Mapping[str, tuple[int, ...]], body: int) -> Edit:
    """Return the edit that gives a body its inertia in numbers: what changes of an element, or a new one."""
    node, target = _node(change, ("body", body)), change.target
    place: Attributes = {"pos": words(target.body_ipos[body])}
    mass: Attributes = {"mass": words(float(target.body_mass[body]))}
    turn: Attributes = {"quat": words(target.body_iquat[body]), "diaginertia": words(target.body_inertia[body])}
    element = next(node.children_of_tag("inertial"), None)
    if element is None:
        text = " ".join(f'{k}="{v}"' for k, v in (place | turn | mass).items())
        return Edit(node, inner_text=f"<inertial {text}/>")
    values: Attributes = {}
    for names, part in (
        (("body_ipos",), place),
        (("body_mass",), mass),
        (("body_inertia", "body_iquat"), turn | {name: None for name in _OTHER_INERTIA}),
    ):
        values |= part if any(body in changed_rows.get(name, ()) for name in names) else {}
    return Edit(element, values)


def _servos(
    change: _Change, changed_rows: Mapping[str, tuple[int, ...]], attributes: Mapping[Key, Attributes]
) -> list[Edit]:
    """Return the edits of actuators: gains in the words of a position servo where it can say them."""
    gain_fields = ("actuator_gaintype", "actuator_gainprm", "actuator_biasprm", "actuator_dynprm", "actuator_ctrlrange")
    gain_ids = {i for field in gain_fields for i in changed_rows.get(field, ())}
    actuator_ids = sorted(gain_ids | {i for kind, i in attributes if kind == "actuator"})
    out = []
    for i in actuator_ids:
        node, values = _node(change, ("actuator", i)), dict(attributes.get(("actuator", i), {}))
        if i not in gain_ids:
            out.append(Edit(node, values))
        elif is_motor(change.target, [i])[0]:
            out.append(Edit(node, _motor(change, node, i), tag=None if node.tag == "dcmotor" else "dcmotor"))
        elif node.tag == "position" and _is_position(change.target, i):
            out.append(Edit(node, values | _gains(change, i)))
        else:
            out.append(Edit(node, values | _general(change, node, i), tag=None if node.tag == "general" else "general"))
    return out


def _gains(change: _Change, i: int) -> Attributes:
    """Return the gains of a position servo that change; a damping ratio becomes the damping that it meant."""
    source, target = change.source, change.target
    values: Attributes = {}
    if source.actuator_gainprm[i, 0] != target.actuator_gainprm[i, 0]:
        values["kp"] = words(float(target.actuator_gainprm[i, 0]))
    # A spec holds a damping ratio as a positive number where the damping is a negative one.
    by_ratio = next(a.biasprm[2] > 0 for a in change.spec.actuators if a.id == i)
    if by_ratio or source.actuator_biasprm[i, 2] != target.actuator_biasprm[i, 2]:
        values |= {"kv": words(float(-target.actuator_biasprm[i, 2])), "dampratio": None}
    return values


def _is_position(model: mujoco.MjModel, i: int) -> bool:
    """Tell whether gain and bias are those of kp (u - q) - kv v."""
    gain, bias = model.actuator_gainprm[i], model.actuator_biasprm[i]
    return bool(bias[0] == 0 and np.isclose(bias[1], -gain[0], rtol=1e-12, atol=0))


def _motor(change: _Change, node: Node, i: int) -> Attributes:
    """Return the attributes with which `dcmotor` describes this actuator.

    Raises
    ------
    SceneError
        When its encoder is off, which the law of a motor has no number for, or its torque limits differ by direction.
    """
    target, name = change.target, change.target.actuator(i).name
    low, high = target.actuator_forcerange[i]
    if not np.array_equal(target.actuator_ctrlrange[i], change.source.actuator_ctrlrange[i]):
        raise SceneError(f"dcmotor {name} has no attribute for an encoder that is off", where=at(node))
    if target.actuator_forcelimited[i] and not np.isclose(-low, high, rtol=1e-12, atol=0):
        raise SceneError(f"dcmotor {name} has no attribute for torque limits of {low:g} and {high:g}", where=at(node))
    resistance, constant, *_ = gain = target.actuator_gainprm[i]
    values: Attributes = {key: None for key in (*_SHORTCUTS, *_GENERAL_ONLY)}
    if target.actuator_ctrllimited[i]:
        values |= {"ctrlrange": words(target.actuator_ctrlrange[i])}
    return values | {
        "input": "pos",
        "motorconst": words(np.array([constant, constant])),
        "resistance": words(float(resistance)),
        "controller": words(np.array([gain[KP], 0.0, gain[KD], target.actuator_dynprm[i, SLEW], 0.0, gain[VOLTAGE]])),
        "saturation": words(np.array([high if target.actuator_forcelimited[i] else 0.0, 0.0, 0.0])),
    }


def _general(change: _Change, node: Node, i: int) -> Attributes:
    """Return the attributes with which `general` describes this actuator."""
    target = change.target
    kinds = (target.actuator_gaintype[i], target.actuator_biastype[i], target.actuator_dyntype[i])
    if any(kind >= len(names) for kind, names in zip(kinds, (_GAINS, _BIASES, _DYNAMICS), strict=True)):
        raise SceneError(f"actuator {target.actuator(i).name} has a law that `general` cannot say", where=at(node))
    gain, bias = (np.array(getattr(target, f"actuator_{name}prm")[i]) for name in ("gain", "bias"))
    used = [np.flatnonzero(v)[-1] + 1 if v.any() else 1 for v in (gain, bias)]
    values: Attributes = {"gainprm": words(gain[: max(1, used[0])]), "biasprm": words(bias[: max(3, used[1])])}
    if node.tag == "general":
        return values
    values |= {name: None for name in _SHORTCUTS}
    values |= {"gaintype": _GAINS[kinds[0]], "biastype": _BIASES[kinds[1]]}
    if kinds[2]:
        values |= {"dyntype": _DYNAMICS[kinds[2]], "dynprm": words(target.actuator_dynprm[i][:3])}
    if node.tag in _SERVO_INPUT:
        values["input"] = _SERVO_INPUT[node.tag]
    return values


def _options(change: _Change, names: list[str]) -> list[Edit]:
    """Return the edits of options: in the section that says them last, else in the last, else in a new one."""
    sections = list(change.root.children_of_tag("option"))
    new_attributes: dict[str, str] = {}
    out = []
    for name in names:
        value = getattr(change.target.opt, name)
        text = WORDS[name][int(value)] if name in WORDS else words(value)
        says = [node for node in sections if name in node.attributes] or sections
        if says:
            out.append(Edit(says[-1], {name: text}))
        else:
            new_attributes[name] = text
    if new_attributes:
        option = "  <option " + " ".join(f'{k}="{v}"' for k, v in new_attributes.items()) + "/>"
        out.append(Edit(change.root, inner_text=option, before_end=True))
    return out
