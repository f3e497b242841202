"""The table is not level: gravity leans in the world frame."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.rotation import exp, rotate
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Turn gravity about world x and y by the rotation vector (tilt_x, tilt_y, 0)."""
    model.opt.gravity = rotate(exp(np.array([x[0], x[1], 0.0])), np.array(model.opt.gravity))


def _tilt(name: str) -> Parameter:
    """Return the parameter of one axis."""
    return Parameter(
        name,
        "rad",
        constant_bounds(-0.3, 0.3),
        values(-0.06, 0.06),
        spans((-0.12, -0.05), (0.05, 0.12)),
        "a table or a base plate levelled by eye is off by one to a few degrees",
        always(0.0),
    )


EFFECT = Effect(
    about="gravity leans, as when table and base are tilted",
    advice=Advice("Tilt gravity by {x}: table or base are not level", "turn gravity of <option>"),
    parameters=(_tilt("tilt_x_rad"), _tilt("tilt_y_rad")),
    acts_on="world",
    possible=lambda scene: bool(np.linalg.norm(scene.model.opt.gravity) > 0),
    edit=_edit,
)
