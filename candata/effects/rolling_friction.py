"""What touches the object resists rolling."""

from __future__ import annotations

import mujoco

from candata.effects import _contact, _select
from candata.effects._contract import Advice, Array, Bounds, Effect, Parameter, scaled_probes, scaled_spans
from candata.scenes.assemble import Scene

#: Rolling friction of a contact whose model has none [m]: MuJoCo's smallest coefficient (`mjMINMU`).
NONE_M = 1e-5


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the value on both sides of every contact with the object, or on one that leads."""
    ids, explicit = _contact.edited_geoms(model, scene, element), _contact.pairs(scene, element)
    _contact.resist(model, ids, 6)
    model.geom_friction[ids, 2] = x[0]
    model.pair_friction[explicit[model.pair_dim[explicit] < 4], 2] = 0.0
    model.pair_dim[explicit] = 6
    model.pair_friction[explicit, 3:] = x[0]


def _nominal_friction(scene: Scene) -> float:
    """Return the rolling friction of the object's contacts [m]."""
    model, friction = scene.model, scene.object_geoms
    rolls = model.geom_condim[friction] >= 6
    return max(NONE_M, float(model.geom_friction[friction, 2][rolls].max(initial=0.0)))


EFFECT = Effect(
    about="rolling friction of contacts with the object is replaced",
    advice=Advice(
        "Set the rolling friction of {surface} to {x}", "{raw} as the third number of friction of the <geom>s, condim 6"
    ),
    parameters=(
        Parameter(
            "rolling_m",
            "m",
            lambda scene: Bounds(min(NONE_M, _nominal_friction(scene)), 0.4 * _select.object_size(scene)),
            scaled_probes(_select.object_size, 0.01, 0.05, 0.15),
            scaled_spans(_select.object_size, (0.05, 0.2)),
            "a pad deformed over a millimetre or more shifts the pressure by as much (Johnson 1985, ch. 9)",
            neutral=_nominal_friction,
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
    elements=_contact.names,
)
