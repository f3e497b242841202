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
    """Move the centre of mass in the body's frame; the inertia about it stays."""
    model.body_ipos[_movable(scene, element)] += x


def _movable(scene: Scene, element: str | None) -> _links.Ids:
    """Return ids of the links but those whose centre MuJoCo compiled onto their axis ("simple"), as a wheel's.

    Their mass matrix has no place for another centre.
    """
    ids = _links.links(scene, element)
    dofs = scene.model.body_dofadr[ids]
    return ids[(scene.model.body_simple[ids] == 0) | (dofs < 0) | (scene.model.dof_simplenum[dofs] == 0)]


def _is_possible(scene: Scene) -> bool:
    """Tell whether the drives feel links, and one of these can have another centre."""
    return _links.has_felt(scene) and len(_movable(scene, None)) > 0


def _elements(scene: Scene) -> tuple[str, ...]:
    """Return the names of links and groups that can have another centre."""
    return tuple(name for name in _links.names(scene) if len(_movable(scene, name)))


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
    possible=_is_possible,
    elements=_elements,
    edit=_edit,
    set_const=True,
)
