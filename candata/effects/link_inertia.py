"""The mass of a link lies closer to its centre, or farther, than modelled."""

from __future__ import annotations

import mujoco

from candata.effects import _links
from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale the inertia about the centre of mass; the mass stays (`link_mass` scales both)."""
    model.body_inertia[_links.links(scene, element)] *= x[0]


EFFECT = Effect(
    about="inertia of links about their centre of mass is scaled, their mass stays",
    advice=Advice(
        "Multiply the inertia of {link} by {x}, its mass unchanged", "multiply diaginertia of its <inertial>"
    ),
    parameters=(
        Parameter(
            "inertia_scale",
            "1",
            constant_bounds(0.15, 6.0),
            values(0.4, 0.7, 1.5, 2.5),
            spans((0.25, 0.5), (2.0, 3.5)),
            "a link with its motors at both ends has three times the inertia of a uniform rod",
            always(1.0),
        ),
    ),
    acts_on="link",
    possible=_links.has_felt_inertia,
    elements=_links.inertia_names,
    edit=_edit,
    set_const=True,
)
