"""Contacts with the object: which geoms and pairs make them, and how one geom comes to decide its own."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.effects import _select
from candata.effects._contract import Array
from candata.errors import UnknownNameError
from candata.scenes.assemble import Scene, subtree

Ids = NDArray[np.int64]
#: The element that is all fingertips together, as worn or dusty pads are, where the object meets other things too.
FINGERTIPS = "fingertips"


def names(scene: Scene) -> tuple[str, ...]:
    """Return what can be slippery or soft on its own: every fingertip, all of them together, and the support."""
    if scene.object_id is None:
        return ()
    return (*scene.file.fingertips, *((FINGERTIPS,) if _is_element(scene) else ()), *_support(scene))


def members(scene: Scene, element: str) -> tuple[str, ...]:
    """Return the fingertips, or the support, that an element of `names` is."""
    return scene.file.fingertips if element == FINGERTIPS and _is_element(scene) else (element,)


def _support(scene: Scene) -> tuple[str, ...]:
    """Return the name of the support, where the scene has one."""
    return (scene.file.support,) if scene.file.support else ()


@lru_cache(maxsize=64)
def _is_element(scene: Scene) -> bool:
    """Tell whether all fingertips together are an element: several, and not all that the object can touch."""
    tips = scene.file.fingertips
    if scene.object_id is None or len(tips) < 2 or FINGERTIPS in (*tips, *_support(scene)):
        return False
    tip_geoms = [g for tip in tips for g in _named_geoms(scene, tip)]
    ends = np.stack([scene.model.pair_geom1, scene.model.pair_geom2], axis=1)[pairs(scene, None)]
    return bool(np.setdiff1d([*_select.contact_geoms(scene), *ends.ravel()], [*tip_geoms, *scene.object_geoms]).size)


def geoms(scene: Scene, element: str | None) -> Ids:
    """Return ids of the geoms that meet the object, its own among them; of fingertips or the support alone.

    Raises
    ------
    UnknownNameError
        When `element` is none of `names`.
    """
    contact_ids = np.array(_select.contact_geoms(scene), int)
    if element is None:
        return contact_ids
    if element not in names(scene):
        raise UnknownNameError("fingertip or support", element, names(scene))
    return contact_ids[np.isin(contact_ids, _element_geoms(scene, element))]


def fingertip_geoms(scene: Scene, element: str | None) -> Ids:
    """Return ids of the geoms of all fingertips, or of the one named, that meet the object."""
    tips = [scene.file.fingertips[i] for i in _select.fingertips(scene, element)]
    return np.concatenate([np.zeros(0, int), *(geoms(scene, tip) for tip in tips)])


def _element_geoms(scene: Scene, element: str) -> list[int]:
    """Return ids of the geoms of an element of `names`."""
    return [g for name in members(scene, element) for g in _named_geoms(scene, name)]


def _named_geoms(scene: Scene, element: str) -> list[int]:
    """Return ids of the geoms that bear a name, or that a body of this name carries (a body wins)."""
    model = scene.model
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, element)
    if body < 0 or element == scene.file.support:
        return [model.geom(element).id]
    bodies = subtree(model, body)
    return [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in bodies]


def pairs(scene: Scene, element: str | None) -> Ids:
    """Return ids of the explicit contact pairs of the object; of those with fingertips or the support alone."""
    model, object_bodies = (
        scene.model,
        subtree(scene.model, scene.object_id or 0) if scene.object_id is not None else set(),
    )
    ends = np.stack([model.pair_geom1, model.pair_geom2], axis=1)
    with_object = np.isin(model.geom_bodyid[ends], list(object_bodies)).any(1)
    if element is not None:
        with_object &= np.isin(ends, _element_geoms(scene, element)).any(1)
    return np.flatnonzero(with_object)


def lead(model: mujoco.MjModel, scene: Scene, ids: Ids) -> None:
    """Let the geoms alone decide their contacts with the object, with the values that these have now.

    A contact takes the larger friction of its two geoms and mixes their softness, unless one has the higher
    priority (MuJoCo manual, "Contact parameters"): only so can one fingertip be more slippery than the object.
    """
    object_geoms = scene.object_geoms
    for g in ids:
        partners = [o for o in object_geoms if _select.collide(scene, int(g), int(o))]
        if not partners or g in object_geoms:
            continue
        top = model.geom_priority[partners].max()
        if model.geom_priority[g] > top:
            continue
        partner = partners[int(np.argmax(model.geom_priority[partners]))]
        has_equal_priority = bool(model.geom_priority[g] == top)
        share = model.geom_solmix[g] / max(model.geom_solmix[g] + model.geom_solmix[partner], mujoco.mjMINVAL)
        share = share if has_equal_priority else 0.0
        friction = np.maximum(model.geom_friction[g], model.geom_friction[partners].max(0))
        model.geom_friction[g] = friction if has_equal_priority else model.geom_friction[partner]
        model.geom_condim[g] = (
            max(model.geom_condim[g], model.geom_condim[partners].max())
            if has_equal_priority
            else (model.geom_condim[partner])
        )
        is_direct = has_equal_priority and min(model.geom_solref[g, 0], model.geom_solref[partner, 0]) <= 0
        mixed_solref = share * model.geom_solref[g] + (1 - share) * model.geom_solref[partner]
        model.geom_solref[g] = (
            np.minimum(model.geom_solref[g], model.geom_solref[partner]) if is_direct else mixed_solref
        )
        model.geom_solimp[g] = share * model.geom_solimp[g] + (1 - share) * model.geom_solimp[partner]
        model.geom_priority[g] = top + 1


def edited_geoms(model: mujoco.MjModel, scene: Scene, element: str | None) -> Ids:
    """Return the geoms to edit: all that meet the object, or those of one element, which then lead."""
    ids = geoms(scene, element)
    if element is not None:
        lead(model, scene, ids)
    return ids


def resist(model: mujoco.MjModel, ids: Ids, condim: int) -> None:
    """Raise the contact dimension of geoms; directions that were free before start without friction."""
    without_torsion, without_rolling = model.geom_condim[ids] < 4, model.geom_condim[ids] < 6
    if condim >= 4:
        model.geom_friction[ids[without_torsion], 1] = 0.0
    if condim >= 6:
        model.geom_friction[ids[without_rolling], 2] = 0.0
    model.geom_condim[ids] = np.maximum(model.geom_condim[ids], condim)


def change_solref(model: mujoco.MjModel, scene: Scene, element: str | None, change: Callable[[Array], Array]) -> None:
    """Replace solref `(m, 2)` of the contacts with the object by what `change` makes of it."""
    ids, explicit = edited_geoms(model, scene, element), pairs(scene, element)
    model.geom_solref[ids] = change(model.geom_solref[ids])
    model.pair_solref[explicit] = change(model.pair_solref[explicit])


def time_form(solref: Array) -> Array:
    """Return solref `(m, 2)` as (time constant [s], damping ratio), whichever form it has.

    The direct form (-k, -b) has b = 2 / timeconst and k = 1 / (timeconst dampratio)^2 (MuJoCo manual, "Solver
    parameters", with dmax 1).
    """
    stiffness, damping = np.maximum(-solref, 1e-9).T
    direct = np.stack([2 / damping, damping / (2 * np.sqrt(stiffness))], axis=1)
    return np.where(solref[:, :1] > 0, solref, direct)
