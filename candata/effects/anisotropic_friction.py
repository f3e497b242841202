"""Contacts are more slippery in one direction than in the other."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _contact
from candata.effects._contract import Advice, Array, Effect, Parameter, constant_bounds, spans, values
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Set the second sliding direction of every explicit pair to `ratio` times the first."""
    ids = _contact.pairs(scene, None)
    model.pair_friction[ids, 1] = x[0] * model.pair_friction[ids, 0]


def _nominal_ratio(scene: Scene) -> float:
    """Return the median ratio of the second sliding direction to the first; 1 where there are no pairs."""
    friction = scene.model.pair_friction[_contact.pairs(scene, None)]
    if not len(friction):
        return 1.0
    return float(np.median(friction[:, 1] / np.maximum(friction[:, 0], mujoco.mjMINVAL)))


EFFECT = Effect(
    about="friction of the second sliding direction is replaced by a ratio of the first",
    advice=Advice(
        "Make friction in the second sliding direction {x} times that in the first",
        "the second number of friction of the <pair>s",
    ),
    parameters=(
        Parameter(
            "ratio",
            "1",
            constant_bounds(0.05, 20.0),
            values(0.5, 2.0),
            spans((0.3, 0.65), (1.6, 3.0)),
            "brushed or grained surfaces differ by up to a factor of three with direction",
            neutral=_nominal_ratio,
        ),
    ),
    acts_on="object",
    # Geoms have one sliding coefficient; only explicit pairs have two (MuJoCo manual, contact/pair).
    possible=lambda scene: len(_contact.pairs(scene, None)) > 0,
    edit=_edit,
)
