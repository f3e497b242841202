"""Links are heavier or lighter than modelled."""

from __future__ import annotations

import mujoco

from candata.effects import _links
from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale mass and inertia about the centre of mass together: another density."""
    ids = _links.links(scene, element)
    model.body_mass[ids] *= x[0]
    model.body_inertia[ids] *= x[0]


EFFECT = Effect(
    about="mass and inertia of links are scaled: gravity and inertia of a heavier link",
    advice=Advice(
        "Multiply mass and inertia of {link} by {x}",
        "multiply mass or density of its <geom>s by {raw}, or mass and diaginertia of its <inertial>",
    ),
    parameters=(
        Parameter(
            "mass_scale",
            "1",
            constant_bounds(0.2, 5.0),
            values(0.5, 0.75, 1.35, 2.0),
            spans((0.4, 0.65), (1.6, 2.5)),
            "motors, cables, covers and payloads that a CAD export leaves out or counts as solid",
            always(1.0),
        ),
    ),
    acts_on="link",
    possible=_links.has_felt,
    elements=_links.names,
    edit=_edit,
    set_const=True,
)
