"""The recording's clock runs fast or slow against the commands: readings drift away from them."""

from __future__ import annotations

import mujoco

from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene
from candata.units import TO_SI


def _pace(scene: Scene, x: Array) -> float:
    """Return the true time between two rows, in nominal control steps: less than one where the clock is fast."""
    return float(1 / (1 + x[0] * TO_SI["ppm"]))


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale the physics step, so that the steps of a row last as long as the row does."""
    model.opt.timestep *= _pace(scene, x)


EFFECT = Effect(
    about="the clock of the readings runs fast or slow against that of the commands",
    advice=Advice("Correct the clock of the readings: it is off by {x}"),
    traits=frozenset({"tracked_length"}),
    parameters=(
        Parameter(
            "ppm",
            "ppm",
            constant_bounds(-50000.0, 50000.0),
            values(-12000.0, 12000.0),
            spans((-25000.0, -8000.0), (8000.0, 25000.0)),
            "crystals: 10 to 100 ppm, which seconds cannot show; loops stamped at a nominal rate they do not keep: "
            "0.5 to 3 %",
            always(0.0),
        ),
    ),
    acts_on="world",
    possible=lambda scene: len(scene.actuator_ids) > 0,
    edit=_edit,
    pace=_pace,
)
