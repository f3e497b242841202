"""The fingertips resist twisting more or less than modelled."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _contact, _select
from candata.effects._contract import Advice, Array, Effect, Parameter, constant_bounds, spans, values
from candata.scenes.assemble import Scene

#: Torsional friction of a contact whose model has none [m]: MuJoCo's smallest coefficient (`mjMINMU`).
NONE_M = 1e-5


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the value of the fingertips, which lead, so that it holds below the object's own too."""
    ids, explicit = _contact.fingertip_geoms(scene, element), _pairs(scene, element)
    _contact.lead(model, scene, ids)
    _contact.resist(model, ids, 4)
    model.geom_friction[ids, 1] = x[0]
    model.pair_dim[explicit] = np.maximum(model.pair_dim[explicit], 4)
    model.pair_friction[explicit, 2] = x[0]


def _pairs(scene: Scene, element: str | None) -> _contact.Ids:
    """Return the explicit pairs of the fingertips."""
    tips = scene.file.fingertips if element is None else (element,)
    return np.concatenate([np.zeros(0, int), *(_contact.pairs(scene, tip) for tip in tips)])


def _nominal_friction(scene: Scene) -> float:
    """Return the median torsional friction of contacts between fingertips and object [m]; the least without any."""
    model, tips = scene.model, _contact.fingertip_geoms(scene, None)
    if not len(tips):
        return NONE_M
    twist = np.maximum(model.geom_friction[tips, 1], model.geom_friction[scene.object_geoms, 1].max())
    dim = np.maximum(model.geom_condim[tips], model.geom_condim[scene.object_geoms].max())
    return max(NONE_M, float(np.median(np.where(dim >= 4, twist, NONE_M))))


def _can_act(scene: Scene) -> bool:
    """Tell whether fingertips can touch the object."""
    return _select.has_object(scene) and len(_contact.fingertip_geoms(scene, None)) > 0


EFFECT = Effect(
    about="torsional friction of the fingertips is replaced",
    advice=Advice(
        "Set the torsional friction of {tip} to {x}",
        "{raw} as the second number of friction of the <geom>, condim 4 or more, and a higher priority",
    ),
    parameters=(
        Parameter(
            "torsional_m",
            "m",
            constant_bounds(NONE_M, 0.1),
            values(0.0005, 0.01, 0.02),
            spans((0.012, 0.04)),
            "a soft pad of 5 to 15 mm resists twisting by about 2/3 of its contact radius (Howe & Cutkosky 1996)",
            neutral=_nominal_friction,
        ),
    ),
    acts_on="fingertip",
    possible=_can_act,
    edit=_edit,
    elements=_select.fingertip_names,
)
