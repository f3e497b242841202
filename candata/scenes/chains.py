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

#: How parts are called that touch, the surest first; letters after it that make other words of it are left out.
_TOUCHING = (re.compile(r"tip(?![lop])", re.IGNORECASE), re.compile(r"pad(?![a-z])", re.IGNORECASE))
#: Hinges that carry a whole hand and are still its wrist; of more it is an arm. Chosen: a wrist has up to three axes.
_WRIST_HINGES = 3
#: What ends the common beginning of a finger's joints and is no name: separators, numbers, `j` and `joint`.
_ENDING = re.compile(r"(?:[\W_\d]|joint|j)+$", re.IGNORECASE)


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


def driven(model: mujoco.MjModel) -> dict[int, int]:
    """Return the ids of the joints that an actuator pulls, with that of the first that does."""
    found: dict[int, int] = {}
    for actuator, pulled in levers(model, range(model.nactuator)).items():
        for joint in pulled:
            found.setdefault(joint, actuator)
    return found


def driven_trees(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the top bodies whose trees an actuator moves, in whatever way."""
    bodies = [int(model.jnt_bodyid[joint]) for joint in driven(model)]
    for actuator in range(model.nactuator):
        kind, first = mujoco.mjtTrn(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        if kind == mujoco.mjtTrn.mjTRN_BODY:
            bodies.append(first)
        elif kind in (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK):
            bodies.append(int(model.site_bodyid[first]))
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            start = int(model.tendon_adr[first])
            wraps = range(start, start + int(model.tendon_num[first]))
            sites = [w for w in wraps if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_SITE]
            bodies += [int(model.site_bodyid[model.wrap_objid[w]]) for w in sites]
        elif first >= 0:
            bodies.append(int(model.jnt_bodyid[first]))
    return {int(model.body_rootid[body]) for body in bodies} - {0}


def above(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of a body and of all that carry it, up to the one on the world."""
    found = []
    while body != 0:
        found.append(body)
        body = int(model.body_parentid[body])
    return found


def colliding(model: mujoco.MjModel, geom: int) -> bool:
    """Tell whether a geom's bit masks let it touch anything."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def floats(model: mujoco.MjModel, body: int) -> bool:
    """Tell whether a body moves freely, and no weld or connection holds any of what it carries."""
    joint = int(model.body_jntadr[body])
    if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return False
    carried = subtree(model, body)
    holding = np.isin(model.eq_type, [int(mujoco.mjtEq.mjEQ_WELD), int(mujoco.mjtEq.mjEQ_CONNECT)])
    pairs = zip(model.eq_objtype[holding], model.eq_obj1id[holding], model.eq_obj2id[holding], strict=True)
    return not any(of != mujoco.mjtObj.mjOBJ_BODY or len(carried & {int(a), int(b)}) == 1 for of, a, b in pairs)


def chain_ends(model: mujoco.MjModel, trees: Iterable[int]) -> list[Tip]:
    """Return the last links with colliding geoms of all chains in some trees, in the order of the model.

    Where something is driven, a chain has a driven joint: a camera on a neck is none.
    """
    roots = set(trees)
    links = sorted({int(w) for b, w in enumerate(model.body_weldid) if w != 0 and int(model.body_rootid[b]) in roots})
    touching = [link for link in links if _touching(model, link)]
    carrying = {up for link in touching for up in _links_above(model, link)}
    ends, moving = [link for link in touching if link not in carrying], _driven_bodies(model)
    ends = [link for link in ends if not moving or moving.intersection(above(model, link))]
    return [tip for link in ends if (tip := _tip(model, link)) is not None]


def _driven_bodies(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the bodies whose joints an actuator pulls."""
    return {int(model.jnt_bodyid[joint]) for joint in driven(model)}


def _links_above(model: mujoco.MjModel, link: int) -> set[int]:
    """Return the ids of the links that carry a link."""
    return {int(model.body_weldid[body]) for body in above(model, link)} - {link, 0}


def _touching(model: mujoco.MjModel, link: int) -> list[int]:
    """Return the ids of the colliding geoms of a link."""
    on = np.flatnonzero(model.body_weldid[model.geom_bodyid] == link)
    return [int(geom) for geom in on if colliding(model, int(geom))]


def _tip(model: mujoco.MjModel, link: int) -> Tip | None:
    """Return what to name of the last link of a chain; None where nothing on it has a name.

    A body that is called a tip comes first, then a geom that is, then the link as a whole, which a site or an empty
    body on it may call so.
    """
    geoms = _touching(model, link)
    carriers = sorted({int(model.geom_bodyid[geom]) for geom in geoms}, reverse=True)
    named = {name: int(model.geom_bodyid[geom]) for geom in geoms if (name := model.geom(geom).name)}
    # A scene takes a name that a body bears for that body.
    usable = [model.body(body).name for body in carriers] + [
        n for n, on in named.items() if _body(model, n) in (-1, on)
    ]
    whole = model.body(link).name or next(filter(None, usable), "")
    sites = [model.site(int(s)).name for s in np.flatnonzero(model.body_weldid[model.site_bodyid] == link)]
    frames = [model.body(int(b)).name for b in np.flatnonzero(model.body_weldid == link)]
    for rank, word in enumerate(_TOUCHING):
        own = [name for name in usable if word.search(name)]
        if own or (whole and any(word.search(name) for name in (*named, *sites, *frames))):
            marked = [site for site in sites if word.search(site)]
            return Tip(own[0] if own else whole, link, rank, marked[0] if len(marked) == 1 else "")
    return Tip(whole, link, len(_TOUCHING)) if whole else None


def _body(model: mujoco.MjModel, name: str) -> int:
    """Return the id of the body of a name, -1 where none has it."""
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))


def fingertips(ends: Sequence[Tip]) -> tuple[list[Tip], list[Tip]]:
    """Return the ends of chains that are fingertips, those whose names say so if any do, and the others."""
    best = min((tip.rank for tip in ends), default=0)
    return [tip for tip in ends if tip.rank == best], [tip for tip in ends if tip.rank != best]


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
    carried = {joint: [t for t in tips if int(model.jnt_bodyid[joint]) in above(model, t.link)] for joint in joints}
    found: dict[str, tuple[str, ...]] = {}
    taken = {model.joint(joint).name for joint in joints} | {tip.name for tip in tips} | {"fingertips"}
    shared = _beginning([model.joint(joint).name for joint in joints])
    roots = sorted({int(model.body_rootid[tip.link]) for tip in tips})
    for number, root in enumerate(roots, 1):
        own = [tip for tip in tips if int(model.body_rootid[tip.link]) == root]
        hand = [joint for joint, over in carried.items() if len(own) > 1 and over == own]
        slides = [joint for joint in hand if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE]
        hinges = [joint for joint in hand if joint not in slides]
        label = "wrist" if len(hinges) <= _WRIST_HINGES else "arm"
        for name, members in ((label, hinges), ("rails", slides)):
            _add(found, taken, f"{name}{number}" if len(roots) > 1 else name, model, members)
    fingers = [[joint for joint, over in carried.items() if over == [tip]] for tip in tips] if len(tips) > 1 else []
    names = [_finger_name([model.joint(joint).name for joint in members], shared) for members in fingers]
    for number, (name, members) in enumerate(zip(names, fingers, strict=True), 1):
        _add(found, taken, name if name and names.count(name) == 1 else f"finger{number}", model, members)
    return found


def _add(
    found: dict[str, tuple[str, ...]], taken: set[str], name: str, model: mujoco.MjModel, members: Sequence[int]
) -> None:
    """Add a group of several joints; its name is no joint's, no fingertip's and no other group's."""
    while name in taken or name in found:
        name = f"{name}_joints"
    if len(members) > 1:
        found[name] = tuple(model.joint(joint).name for joint in members)


def _finger_name(joints: Sequence[str], shared: str) -> str:
    """Return what the joints of a finger are called together; empty where they have nothing in common."""
    common = _beginning(joints)
    # A beginning that all joints of the hand share says nothing, unless it is cut within a word.
    skip = max((k + 1 for k, letter in enumerate(shared) if letter in "_/:.- "), default=0)
    return _ENDING.sub("", common[skip:])


def _beginning(names: Sequence[str]) -> str:
    """Return the letters with which all names begin."""
    alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    return "".join(letters[0] for letters in alike)
