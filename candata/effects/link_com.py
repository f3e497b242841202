"""The centre of mass of a link is not where the model has it."""

from __future__ import annotations

import mujoco

from candata.effects import _links
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Parameter,
    always,
    scaled_bounds,
    scaled_probes,
    scaled_spans,
)
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Move the centre of mass in the body's frame; the inertia about it stays.

    A body whose centre MuJoCo compiled onto its axis ("simple") keeps it: its mass matrix has no place for another.
    """
    ids = _links.links(scene, element)
    dofs = model.body_dofadr[ids]
    is_fixed = (model.body_simple[ids] > 0) & (dofs >= 0) & (model.dof_simplenum[dofs] > 0)
    model.body_ipos[ids[~is_fixed]] += x


EFFECT = Effect(
    about="centre of mass of links is moved",
    advice=Advice(
        "Move the centre of mass of {link} by {x}, in the body's own frame", "add {raw} to pos of its <inertial>"
    ),
    parameters=(
        Parameter(
            "offset_m",
            "m",
            scaled_bounds(_links.extent, -1.0, 1.0),
            scaled_probes(_links.extent, -0.3, 0.3),
            scaled_spans(_links.extent, (-0.6, -0.3), (0.3, 0.6)),
            "a motor or a payload sits at one end; at most at the end of the link",
            always(0.0),
            size=lambda scene: 3,
        ),
    ),
    acts_on="link",
    possible=_links.has_felt,
    elements=_links.names,
    edit=_edit,
    set_const=True,
)
