"""From the numbers that an edit changed to the attributes of MJCF that say the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from candata.errors import SceneError
from candata.repair.elements import Key, located
from candata.repair.fields import INERTIA, OPTIONS, PLAIN, WORDS, Array, differences, words
from candata.repair.markup import Edit, Node, at

Attributes = dict[str, str | None]
#: What an inertial element may say instead of `quat` and `diaginertia`.
_OTHER_INERTIA = ("fullinertia", "axisangle", "euler", "xyaxes", "zaxis")
#: Attributes of servo shortcuts that `general` has not.
_SHORTCUTS = ("kp", "kv", "dampratio", "timeconst", "area", "diameter", "bias")
_DECLARED = {"position": "pos", "velocity": "vel", "intvelocity": "vel"}
_GAINS = ("fixed", "affine", "muscle")
_BIASES = ("none", "affine", "muscle")
_DYNAMICS = ("none", "integrator", "filter", "filterexact", "muscle")
#: Which number of a size is half the length, by shape that may be given by its ends.
_HALF = {
    mujoco.mjtGeom.mjGEOM_CAPSULE: 1,
    mujoco.mjtGeom.mjGEOM_CYLINDER: 1,
    mujoco.mjtGeom.mjGEOM_BOX: 2,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: 2,
}
#: How many numbers a shape's size has.
_SIZES = {mujoco.mjtGeom.mjGEOM_SPHERE: 1, mujoco.mjtGeom.mjGEOM_CAPSULE: 2, mujoco.mjtGeom.mjGEOM_CYLINDER: 2}


@dataclass(frozen=True)
class _Change:
    """The model as it is and as it shall be, the spec of the text, and where things stand in it."""

    own: mujoco.MjModel
    target: mujoco.MjModel
    spec: mujoco.MjSpec
    root: Node
    nodes: Mapping[Key, Node]


def edits(own: mujoco.MjModel, target: mujoco.MjModel, spec: mujoco.MjSpec, root: Node) -> list[Edit]:
    """Return the edits of an MJCF text that turn its compiled model `own` into `target`.

    Parameters
    ----------
    own, target : mujoco.MjModel
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
    change = _Change(own, target, spec, root, located(spec, root))
    found = {d.field: d.ids for d in differences(own, target)}
    attributes: dict[Key, Attributes] = {}
    for name, (kind, attribute) in PLAIN.items():
        for i in found.get(name, ()):
            key = (kind, int(own.dof_jntid[i]) if kind == "joint" else i)
            attributes.setdefault(key, {})[attribute] = words(_row(target, name, i))
    _springs(change, attributes)
    for i in found.get("actuator_forcelimited", ()):
        attributes.setdefault(("actuator", i), {})["forcelimited"] = str(bool(target.actuator_forcelimited[i])).lower()
    moved = _geometry(change, found, attributes)
    out = [Edit(_node(change, key), values) for key, values in attributes.items() if key[0] != "actuator"]
    out += _servos(change, found, attributes)
    bodies = {i for name in INERTIA for i in found.get(name, ())} | moved
    out += [_inertial(change, found, i) for i in sorted(bodies) if own.body_weldid[i] and own.body_mass[i] > 0]
    return out + _options(change, [name for name in OPTIONS if name in found])


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


def _springs(change: _Change, attributes: dict[Key, Attributes]) -> None:
    """Spell out stiffness and damping of joints that give them as time constant and ratio."""
    for joint in change.spec.joints:
        values = attributes.get(("joint", joint.id), {})
        if "damping" in values and np.any(joint.springdamper):
            values |= {"springdamper": "0 0", "stiffness": words(float(change.own.jnt_stiffness[joint.id]))}


def _geometry(change: _Change, found: Mapping[str, tuple[int, ...]], attributes: dict[Key, Attributes]) -> set[int]:
    """Add places and sizes that change; return the bodies whose inertia would follow them."""
    own, target = change.own, change.target
    scales = _mesh_scales(change) if "mesh_vert" in found else {}
    for mesh in change.spec.meshes:
        if mesh.id in scales:
            attributes.setdefault(("mesh", mesh.id), {})["scale"] = words(scales[mesh.id] * np.array(mesh.scale))
    touched = set(found.get("geom_pos", ())) | set(found.get("geom_size", ()))
    for geom in change.spec.geoms:
        if geom.id in touched:
            values = attributes.setdefault(("geom", geom.id), {})
            values |= _placed(change, geom, scales.get(int(own.geom_dataid[geom.id])))
    for kind, things in (("site", change.spec.sites), ("body", change.spec.bodies)):
        for thing in things:
            if thing.id in found.get(f"{kind}_pos", ()):
                moved = _row(target, f"{kind}_pos", thing.id) - _row(own, f"{kind}_pos", thing.id)
                attributes.setdefault((kind, thing.id), {})["pos"] = words(np.array(thing.pos) + moved)
    return {int(own.geom_bodyid[g]) for g in touched}


def _mesh_scales(change: _Change) -> dict[int, float]:
    """Return by how much each mesh that changes grows, read off the geoms that show it."""
    own, target = change.own, change.target
    shown = np.flatnonzero((own.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (own.geom_size != target.geom_size).any(1))
    return {int(own.geom_dataid[g]): float(target.geom_size[g].max() / own.geom_size[g].max()) for g in shown}


def _placed(change: _Change, geom: mujoco.MjsGeom, scale: float | None) -> Attributes:
    """Return the place and size of one geom in the words of its text: ends, or position and size."""
    own, target, i = change.own, change.target, geom.id
    if scale is not None:
        return {"pos": words(scale * np.array(geom.pos))}
    size = words(target.geom_size[i][: _SIZES.get(geom.type, 3)])
    grown: Attributes = {"size": size} if (own.geom_size[i] != target.geom_size[i]).any() else {}
    ends = np.array(geom.fromto)
    moved = target.geom_pos[i] - own.geom_pos[i]
    if not np.isfinite(ends).all():
        return grown | ({"pos": words(np.array(geom.pos) + moved)} if moved.any() else {})
    along = _HALF[geom.type]
    longer = target.geom_size[i][along] / own.geom_size[i][along]
    middle, half = (ends[:3] + ends[3:]) / 2, (ends[3:] - ends[:3]) / 2
    new = np.concatenate([middle + moved - longer * half, middle + moved + longer * half])
    return {"fromto": words(new), **grown}


def _inertial(change: _Change, found: Mapping[str, tuple[int, ...]], body: int) -> Edit:
    """Return the edit that gives a body its inertia in numbers: what changes of an element, or a new one."""
    node, target = _node(change, ("body", body)), change.target
    place: Attributes = {"pos": words(target.body_ipos[body])}
    mass: Attributes = {"mass": words(float(target.body_mass[body]))}
    turn: Attributes = {"quat": words(target.body_iquat[body]), "diaginertia": words(target.body_inertia[body])}
    stands = next(node.each("inertial"), None)
    if stands is None:
        text = " ".join(f'{k}="{v}"' for k, v in (place | turn | mass).items())
        return Edit(node, inside=f"<inertial {text}/>")
    values: Attributes = {}
    for names, part in (
        (("body_ipos",), place),
        (("body_mass",), mass),
        (("body_inertia", "body_iquat"), turn | {name: None for name in _OTHER_INERTIA}),
    ):
        values |= part if any(body in found.get(name, ()) for name in names) else {}
    return Edit(stands, values)


def _servos(change: _Change, found: Mapping[str, tuple[int, ...]], attributes: Mapping[Key, Attributes]) -> list[Edit]:
    """Return the edits of actuators: gains in the words of a position servo where it can say them."""
    geared = set(found.get("actuator_gainprm", ())) | set(found.get("actuator_biasprm", ()))
    changed = sorted(geared | {i for kind, i in attributes if kind == "actuator"})
    out = []
    for i in changed:
        node, values = _node(change, ("actuator", i)), dict(attributes.get(("actuator", i), {}))
        if i not in geared:
            out.append(Edit(node, values))
        elif node.tag == "position" and _is_position(change.target, i):
            out.append(Edit(node, values | _gains(change, i)))
        else:
            out.append(Edit(node, values | _general(change, node, i), tag=None if node.tag == "general" else "general"))
    return out


def _gains(change: _Change, i: int) -> Attributes:
    """Return the gains of a position servo that change; a damping ratio becomes the damping that it meant."""
    own, target = change.own, change.target
    values: Attributes = {}
    if own.actuator_gainprm[i, 0] != target.actuator_gainprm[i, 0]:
        values["kp"] = words(float(target.actuator_gainprm[i, 0]))
    # A spec holds a damping ratio as a positive number where the damping is a negative one.
    by_ratio = next(a.biasprm[2] > 0 for a in change.spec.actuators if a.id == i)
    if by_ratio or own.actuator_biasprm[i, 2] != target.actuator_biasprm[i, 2]:
        values |= {"kv": words(float(-target.actuator_biasprm[i, 2])), "dampratio": None}
    return values


def _is_position(model: mujoco.MjModel, i: int) -> bool:
    """Tell whether gain and bias are those of kp (u - q) - kv v."""
    gain, bias = model.actuator_gainprm[i], model.actuator_biasprm[i]
    return bool(bias[0] == 0 and np.isclose(bias[1], -gain[0], rtol=1e-12, atol=0))


def _general(change: _Change, node: Node, i: int) -> Attributes:
    """Return the attributes with which `general` says what this actuator is."""
    target = change.target
    kinds = (target.actuator_gaintype[i], target.actuator_biastype[i], target.actuator_dyntype[i])
    if any(kind >= len(known) for kind, known in zip(kinds, (_GAINS, _BIASES, _DYNAMICS), strict=True)):
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
    if node.tag in _DECLARED:
        values["input"] = _DECLARED[node.tag]
    return values


def _options(change: _Change, names: list[str]) -> list[Edit]:
    """Return the edits of options: in the section that says them last, else in the last, else in a new one."""
    sections = list(change.root.each("option"))
    fresh: dict[str, str] = {}
    out = []
    for name in names:
        value = getattr(change.target.opt, name)
        text = WORDS[name][int(value)] if name in WORDS else words(value)
        says = [node for node in sections if name in node.attributes] or sections
        if says:
            out.append(Edit(says[-1], {name: text}))
        else:
            fresh[name] = text
    if fresh:
        option = "  <option " + " ".join(f'{k}="{v}"' for k, v in fresh.items()) + "/>"
        out.append(Edit(change.root, inside=option, before_end=True))
    return out
