"""An arm that carries a hand, as one model: each is a registered one, or a file of the user's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import SceneError, UnknownNameError, Where
from candata.plugins import Registry
from candata.scenes.contract import ARMS, HANDS, Arm, Hand
from candata.scenes.model_file import compile_model, model_path, read_model
from candata.scenes.tabletop import exclude_pairs, table

#: Begins the names of all that a hand's file brings.
HAND_PREFIX = "hand_"
#: Endings of model files, by which a name that is not registered is known to be one.
_ENDINGS = (".xml", ".mjcf", ".urdf")
_UNTURNED = (1.0, 0.0, 0.0, 0.0)
#: Keyframes by name: positions and commands.
Keyframes = Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]


def compose(
    arm: str,
    hand: str,
    *,
    at: str | None = None,
    path: Path = Path("scene.yaml"),
    world: mujoco.MjSpec | None = None,
    base_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> mujoco.MjSpec:
    """Return a model in which an arm carries a hand.

    Registered arms and hands keep their names, and a file of an arm keeps its own: it may hold a table and an object
    too. Of the file of a hand the bodies are taken, all names with `HAND_PREFIX`; floors and lights stay behind, and a
    free joint of its base goes. The options are those of the arm's file, or of the world. Each keyframe of either file
    holds for both: the other is then in its keyframe of the same name, else in its first one, else at its start.

    Parameters
    ----------
    arm, hand : str
        Registered name, or a model file: beside `path`, `PACKAGE:FILE` or `mujoco_menagerie:ID`.
    at : str, optional
        Site of the arm that carries the hand, whose base takes its place and attitude. By default the registered arm's
        flange.
    path : Path
        Scene file that names them.
    world : mujoco.MjSpec, optional
        What a registered arm is added to; by default a table.
    base_m : tuple of float
        Where a registered arm stands in it [m].

    Raises
    ------
    DataError
        When a file is a Git LFS pointer.
    SceneError
        When a file is missing or no model, the arm has no such site, or names clash.
    UnknownNameError
        When a name is neither registered nor a file.
    """
    arm_part, hand_part = _part(arm, ARMS, path), _part(hand, HANDS, path)
    if isinstance(arm_part, Arm):
        spec = table() if world is None else world
        arm_part.add(spec, spec.worldbody, base_m, _UNTURNED)
        at = at or arm_part.flange
    else:
        spec = arm_part
    site = _site(spec, arm, at, path)
    arm_keys, hand_keys = _take_keyframes(spec, arm), _keyframes_of_fixed(hand_part, hand)
    if isinstance(arm_part, Arm) and world is None:  # who brings a world adds its keyframes, with what else is in it
        arm_keys = {"open": (np.array(arm_part.start), np.array(arm_part.start))}
    try:
        roots = _mount(spec, site, hand_part)
    except ValueError as error:
        raise SceneError(
            f"arm {arm} cannot carry hand {hand}: {' '.join(str(error).split()).removeprefix('Error: ')}",
            expected="names in the file of the arm that the hand does not bring",
            where=Where(path=str(path)),
            fix="rename it in the file of the arm",
        ) from None
    _add_keyframes(spec, roots, arm_keys, hand_keys)
    return spec


def _part(name: str, registry: Registry, path: Path) -> Arm | Hand | mujoco.MjSpec:
    """Return the registered arm or hand of a name, else the spec of a file."""
    if name in registry:
        part: Arm | Hand = registry.load(name)
        return part
    file = model_path(path, name)
    if file.is_file():
        return read_model(file)
    if file.suffix.lower() in _ENDINGS or ":" in name:
        raise SceneError(f"model {name} does not exist", expected=str(file), where=Where(path=str(path)))
    raise UnknownNameError(f"{registry.constant.lower()} or model file", name, registry.names(), Where(path=str(path)))


def _site(spec: mujoco.MjSpec, arm: str, at: str | None, path: Path) -> mujoco.MjsSite:
    """Return the site of an arm that carries the hand."""
    site = spec.site(at) if at else None
    if site is None:
        names = ", ".join(s.name for s in spec.sites if s.name)
        raise SceneError(
            f"arm {arm} has no site {at}" if at else f"where arm {arm} carries the hand is not said",
            expected=f"one of {names}" if names else "a site in the model of the arm, on its last link",
            where=Where(path=str(path)),
            fix="name it: `model: {arm: ..., hand: ..., at: SITE}`" if names else "add <site> to the last link",
        )
    return site


def _take_keyframes(spec: mujoco.MjSpec, name: str) -> Keyframes:
    """Return the keyframes of a spec, and delete them: they have no place for what is added."""
    keys = list(spec.keys)
    if not keys:
        return {}
    model = compile_model(spec, name)
    values = {model.key(k).name: (model.key_qpos[k].copy(), model.key_ctrl[k].copy()) for k in range(model.nkey)}
    for key in keys:
        spec.delete(key)
    return values


def _keyframes_of_fixed(hand: Hand | mujoco.MjSpec, name: str) -> Keyframes:
    """Return the keyframes of a hand once the free joints of its bases are deleted; none where there are such."""
    if isinstance(hand, Hand):
        return {}
    free_joints = [j for body in hand.worldbody.bodies for j in body.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]
    for element in (*free_joints, *(hand.keys if free_joints else ())):
        hand.delete(element)
    return _take_keyframes(hand, name)


def _mount(spec: mujoco.MjSpec, site: mujoco.MjsSite, hand: Hand | mujoco.MjSpec) -> list[mujoco.MjsBody]:
    """Return the bodies of a hand that a site of `spec` now carries; the options of `spec` hold."""
    if isinstance(hand, Hand):
        place = compile_model(spec, "of an arm").site(site.name)  # whatever way the file writes it
        mount = site.parent.add_body(name="mount", pos=place.pos, quat=place.quat)
        hand.add(spec, mount, _UNTURNED)
        exclude_pairs(spec, [body.name for body in mount.find_all("body")])
        return [mount]
    for option in (name for name in dir(spec.option) if not name.startswith("_")):
        setattr(hand.option, option, getattr(spec.option, option))
    if not list(hand.worldbody.bodies):
        raise SceneError("the model of the hand has no bodies", fix="name the file of a hand")
    hand.memory, hand.njmax, hand.nconmax, hand.nstack = spec.memory, spec.njmax, spec.nconmax, spec.nstack
    return [site.attach_body(body, HAND_PREFIX, "") for body in list(hand.worldbody.bodies)]


def _add_keyframes(
    spec: mujoco.MjSpec, roots: Sequence[mujoco.MjsBody], arm_keys: Keyframes, hand_keys: Keyframes
) -> None:
    """Add the keyframes of both; `roots` are the bodies of the hand."""
    if not (arm_keys or hand_keys):
        return
    model = compile_model(spec, "of an arm with a hand")
    is_hand = np.zeros(model.nq, bool)
    for joint in (j for root in roots for j in root.find_all("joint")):
        start = model.jnt_qposadr[joint.id]
        is_hand[start : start + (4 if joint.type == mujoco.mjtJoint.mjJNT_BALL else 1)] = True
    for name in dict.fromkeys((*arm_keys, *hand_keys)):
        qpos, ctrl = model.qpos0.copy(), np.zeros(model.nu)
        for keys, places, columns in (
            (arm_keys, ~is_hand, slice(0, _commands(arm_keys))),
            (hand_keys, is_hand, slice(model.nu - _commands(hand_keys), model.nu)),
        ):
            if keys:
                qpos[places], ctrl[columns] = keys.get(name, next(iter(keys.values())))
        spec.add_key(name=name, qpos=qpos, ctrl=ctrl)


def _commands(keys: Keyframes) -> int:
    """Return how many commands keyframes hold: of an arm the first of the model, of a hand the last."""
    return len(next(iter(keys.values()))[1]) if keys else 0
