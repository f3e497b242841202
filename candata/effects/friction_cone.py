"""The simulator's friction cone is the other one: a discrete setting of the solver."""

from __future__ import annotations

import mujoco

from candata.effects import _select
from candata.effects._contract import Advice, Array, Effect, Parameter, constant_bounds
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the cone."""
    model.opt.cone = int(x[0])


def _other_cones(scene: Scene) -> tuple[float, ...]:
    """Return the cone that the scene does not have."""
    return (1.0 - float(scene.model.opt.cone),)


EFFECT = Effect(
    about="friction cone of the contact solver is replaced",
    advice=Advice("Use the {x} friction cone", '<option cone="{raw}"/>'),
    traits=frozenset({"simulator", "solver"}),
    parameters=(
        Parameter(
            "cone",
            "1",
            constant_bounds(0, 1),
            _other_cones,
            lambda scene: tuple((v, v) for v in _other_cones(scene)),
            "MuJoCo manual, option/cone: pyramidal is the default, elliptic is the isotropic law",
            neutral=lambda scene: float(scene.model.opt.cone),
            choices=("pyramidal", "elliptic"),
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
)
