"""Links, fingers and fingertips of a robot, read off its kinematic tree."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile

import mujoco
import numpy as np

from candata.scenes.assemble import subtree
from candata.scenes.transmission import levers

#: Words in the names of parts that touch, the surest first; the letters that may not follow make other words.
_TIP_WORDS = (re.compile(r"tip(?![lop])", re.IGNORECASE), re.compile(r"pad(?![a-z])", re.IGNORECASE))
#: Hinges that carry a whole hand and are still its wrist; of more it is an arm. Chosen: a wrist has up to three axes.
_WRIST_HINGES = 3
#: Ending of the common prefix of a finger's joints that is no name: separators, numbers, `j` and `joint`.
_SUFFIX = re.compile(r"(?:[\W_\d]|joint|j)+$", re.IGNORECASE)


@dataclass(frozen=True)
class Tip:
    """The end of a chain of links.

    Attributes
    ----------
    name : str
        The body or geom to name in a scene.
    link : int
        Id of the first body of the rigid link that it is a part of.
    rank : int
        How surely its names say that it touches: 0 for a tip, 1 for a pad, 2 for none of them.
    site : str
        The site on it that is called a tip; empty where there is none, or more than one.
    """

    name: str
    link: int
    rank: int
    site: str = ""


def actuator_of_joint(model: mujoco.MjModel) -> dict[int, int]:
    """Return the ids of the joints that an actuator pulls, with that of the first that does."""
    actuator_of: dict[int, int] = {}
    for actuator, joints in levers(model, range(model.nactuator)).items():
        for joint in joints:
            actuator_of.setdefault(joint, actuator)
    return actuator_of


def driven_trees(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the top bodies whose trees an actuator moves, in whatever way."""
    bodies = [int(model.jnt_bodyid[joint]) for joint in actuator_of_joint(model)]
    for actuator in range(model.nactuator):
        kind, target_id = mujoco.mjtTrn(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        if kind == mujoco.mjtTrn.mjTRN_BODY:
            bodies.append(target_id)
        elif kind in (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK):
            bodies.append(int(model.site_bodyid[target_id]))
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            start = int(model.tendon_adr[target_id])
            wraps = range(start, start + int(model.tendon_num[target_id]))
            sites = [w for w in wraps if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_SITE]
            bodies += [int(model.site_bodyid[model.wrap_objid[w]]) for w in sites]
        elif target_id >= 0:
            bodies.append(int(model.jnt_bodyid[target_id]))
    return {int(model.body_rootid[body]) for body in bodies} - {0}


def carrying_bodies(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of a body and of all that carry it, up to the one on the world."""
    bodies = []
    while body != 0:
        bodies.append(body)
        body = int(model.body_parentid[body])
    return bodies


def can_collide(model: mujoco.MjModel, geom: int) -> bool:
    """Tell whether a geom's bit masks let it touch anything."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def floats(model: mujoco.MjModel, body: int) -> bool:
    """Tell whether a body moves freely, and no weld or connection holds any of what it carries."""
    joint = int(model.body_jntadr[body])
    if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return False
    tree = subtree(model, body)
    is_fixed = np.isin(model.eq_type, [int(mujoco.mjtEq.mjEQ_WELD), int(mujoco.mjtEq.mjEQ_CONNECT)])
    pairs = zip(model.eq_objtype[is_fixed], model.eq_obj1id[is_fixed], model.eq_obj2id[is_fixed], strict=True)
    return not any(of != mujoco.mjtObj.mjOBJ_BODY or len(tree & {int(a), int(b)}) == 1 for of, a, b in pairs)


def chain_ends(model: mujoco.MjModel, trees: Iterable[int]) -> list[Tip]:
    """Return the last links with colliding geoms of all chains in some trees, in the order of the model.

    If any joint is driven, a chain needs a driven joint: a camera on a neck is none.
    """
    roots = set(trees)
    links = sorted({int(w) for b, w in enumerate(model.body_weldid) if w != 0 and int(model.body_rootid[b]) in roots})
    colliding_links = [link for link in links if _colliding_geoms(model, link)]
    carrier_links = {carrier for link in colliding_links for carrier in _links_above(model, link)}
    ends, driven_bodies = [link for link in colliding_links if link not in carrier_links], _driven_bodies(model)
    ends = [link for link in ends if not driven_bodies or driven_bodies.intersection(carrying_bodies(model, link))]
    return [tip for link in ends if (tip := _tip(model, link)) is not None]


def _driven_bodies(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the bodies whose joints an actuator pulls."""
    return {int(model.jnt_bodyid[joint]) for joint in actuator_of_joint(model)}


def _links_above(model: mujoco.MjModel, link: int) -> set[int]:
    """Return the ids of the links that carry a link."""
    return {int(model.body_weldid[body]) for body in carrying_bodies(model, link)} - {link, 0}


def _colliding_geoms(model: mujoco.MjModel, link: int) -> list[int]:
    """Return the ids of the colliding geoms of a link."""
    geom_ids = np.flatnonzero(model.body_weldid[model.geom_bodyid] == link)
    return [int(geom) for geom in geom_ids if can_collide(model, int(geom))]


def _tip(model: mujoco.MjModel, link: int) -> Tip | None:
    """Return the part to name on the last link of a chain; None if nothing on it has a name.

    A body that is called a tip comes first, then a geom that is, then the link as a whole, which a site or an empty
    body on it may call so.
    """
    geoms = _colliding_geoms(model, link)
    carriers = sorted({int(model.geom_bodyid[geom]) for geom in geoms}, reverse=True)
    body_of_geom = {name: int(model.geom_bodyid[geom]) for geom in geoms if (name := model.geom(geom).name)}
    # A scene takes a name that a body bears for that body.
    usable = [model.body(body).name for body in carriers] + [
        n for n, carrier in body_of_geom.items() if _body(model, n) in (-1, carrier)
    ]
    link_name = model.body(link).name or next(filter(None, usable), "")
    sites = [model.site(int(s)).name for s in np.flatnonzero(model.body_weldid[model.site_bodyid] == link)]
    frames = [model.body(int(b)).name for b in np.flatnonzero(model.body_weldid == link)]
    for rank, word in enumerate(_TIP_WORDS):
        tip_names = [name for name in usable if word.search(name)]
        if tip_names or (link_name and any(word.search(name) for name in (*body_of_geom, *sites, *frames))):
            tip_sites = [site for site in sites if word.search(site)]
            return Tip(
                tip_names[0] if tip_names else link_name, link, rank, tip_sites[0] if len(tip_sites) == 1 else ""
            )
    return Tip(link_name, link, len(_TIP_WORDS)) if link_name else None


def _body(model: mujoco.MjModel, name: str) -> int:
    """Return the id of the body of a name, -1 where none has it."""
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))


def fingertips(ends: Sequence[Tip]) -> tuple[list[Tip], list[Tip]]:
    """Return the ends of chains that are fingertips, those whose names say so if any do, and the others."""
    best_rank = min((tip.rank for tip in ends), default=0)
    return [tip for tip in ends if tip.rank == best_rank], [tip for tip in ends if tip.rank != best_rank]


def groups(model: mujoco.MjModel, tips: Sequence[Tip], joints: Sequence[int]) -> dict[str, tuple[str, ...]]:
    """Return joints by finger, and those that carry all of a hand's fingers as its wrist or arm, and its rails.

    Parameters
    ----------
    model : mujoco.MjModel
        The model.
    tips : sequence of Tip
        The fingertips.
    joints : sequence of int
        Ids of the joints that are listed and move by themselves.
    """
    tips_of_joint = {
        joint: [t for t in tips if int(model.jnt_bodyid[joint]) in carrying_bodies(model, t.link)] for joint in joints
    }
    joint_groups: dict[str, tuple[str, ...]] = {}
    used_names = {model.joint(joint).name for joint in joints} | {tip.name for tip in tips} | {"fingertips"}
    common_prefix = _common_prefix([model.joint(joint).name for joint in joints])
    roots = sorted({int(model.body_rootid[tip.link]) for tip in tips})
    for number, root in enumerate(roots, 1):
        hand_tips = [tip for tip in tips if int(model.body_rootid[tip.link]) == root]
        hand = [joint for joint, joint_tips in tips_of_joint.items() if len(hand_tips) > 1 and joint_tips == hand_tips]
        slides = [joint for joint in hand if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE]
        hinges = [joint for joint in hand if joint not in slides]
        label = "wrist" if len(hinges) <= _WRIST_HINGES else "arm"
        for name, members in ((label, hinges), ("rails", slides)):
            _add(joint_groups, used_names, f"{name}{number}" if len(roots) > 1 else name, model, members)
    fingers = (
        [[joint for joint, joint_tips in tips_of_joint.items() if joint_tips == [tip]] for tip in tips]
        if len(tips) > 1
        else []
    )
    names = [_finger_name([model.joint(joint).name for joint in members], common_prefix) for members in fingers]
    for number, (name, members) in enumerate(zip(names, fingers, strict=True), 1):
        _add(joint_groups, used_names, name if name and names.count(name) == 1 else f"finger{number}", model, members)
    return joint_groups


def _add(
    joint_groups: dict[str, tuple[str, ...]],
    used_names: set[str],
    name: str,
    model: mujoco.MjModel,
    members: Sequence[int],
) -> None:
    """Add a group of several joints; its name is no joint's, no fingertip's and no other group's."""
    while name in used_names or name in joint_groups:
        name = f"{name}_joints"
    if len(members) > 1:
        joint_groups[name] = tuple(model.joint(joint).name for joint in members)


def _finger_name(joints: Sequence[str], common_prefix: str) -> str:
    """Return the common name of the joints of a finger; empty if their names have nothing in common."""
    finger_prefix = _common_prefix(joints)
    # A beginning that all joints of the hand share says nothing, unless it is cut within a word.
    skip = max((k + 1 for k, letter in enumerate(common_prefix) if letter in "_/:.- "), default=0)
    return _SUFFIX.sub("", finger_prefix[skip:])


def _common_prefix(names: Sequence[str]) -> str:
    """Return the letters with which all names begin."""
    equal_letters = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    return "".join(letters[0] for letters in equal_letters)
