"""Friction is stiffer or softer against the contact's normal than modelled: a setting of the solver."""

from __future__ import annotations

import mujoco

from candata.effects import _select
from candata.effects._contract import Advice, Array, Effect, Parameter, scaled_bounds, scaled_probes, scaled_spans
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the ratio of frictional to normal impedance."""
    model.opt.impratio = x[0]


def _nominal_impratio(scene: Scene) -> float:
    """Return the scene's ratio."""
    return float(scene.model.opt.impratio)


EFFECT = Effect(
    about="ratio of frictional to normal impedance of the contact solver is replaced",
    advice=Advice("Set impratio to {x}", '<option impratio="{raw}"/>'),
    traits=frozenset({"simulator", "solver"}),
    parameters=(
        Parameter(
            "impratio",
            "1",
            scaled_bounds(_nominal_impratio, 0.01, 200.0),
            scaled_probes(_nominal_impratio, 0.1, 0.5, 2.0, 10.0),
            scaled_spans(_nominal_impratio, (0.06, 0.15), (8.0, 15.0)),
            "MuJoCo manual, option/impratio: 1 is the default, models of hands use 10 to 100 against slip",
            neutral=_nominal_impratio,
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
)
