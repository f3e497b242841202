"""Everything that touches the object is more or less slippery than modelled."""

from __future__ import annotations

import mujoco

from candata.effects import _contact, _select
from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale every geom that can touch the object, as a pair takes the larger of its two values; or one that leads."""
    if x[0] == 1:
        return
    model.geom_friction[_contact.edited_geoms(model, scene, element), 0] *= x[0]
    model.pair_friction[_contact.pairs(scene, element), :2] *= x[0]


EFFECT = Effect(
    about="sliding friction of object, fingertips and support is scaled",
    advice=Advice(
        "Multiply the sliding friction of {surface} by {x}",
        "multiply the first number of friction of the <geom>s (a contact takes the larger of its two: change "
        "all, or give one a higher priority)",
    ),
    parameters=(
        Parameter(
            "scale",
            "1",
            constant_bounds(0.1, 5.0),
            values(0.45, 0.7, 1.4, 2.2),
            spans((0.35, 0.7), (1.4, 2.2)),
            "tables of friction coefficients spread by a factor of two",
            always(1.0),
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
    elements=_contact.names,
)
