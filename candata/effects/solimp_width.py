"""Contacts reach their full stiffness deeper or shallower than modelled: a setting of the solver."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _contact
from candata.effects._contract import Advice, Array, Effect, Parameter, scaled_bounds, scaled_probes, scaled_spans
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the width of solimp, the depth over which the impedance grows to its full value: others in proportion.

    Softer fingertips stay softer than the object, and at the object's own width nothing changes.
    """
    share = x[0] / _nominal_width(scene)
    model.geom_solimp[_contact.geoms(scene, None), 2] *= share
    model.pair_solimp[_contact.pairs(scene, None), 2] *= share


def _nominal_width(scene: Scene) -> float:
    """Return the median width of the object's geoms [m]; MuJoCo's default where there is no object."""
    if not len(scene.object_geoms):
        return 0.001
    return float(np.median(scene.model.geom_solimp[scene.object_geoms, 2]))


def _grows(scene: Scene) -> bool:
    """Tell whether the object's impedance grows with depth at all."""
    solimp = scene.model.geom_solimp[scene.object_geoms]
    return bool((solimp[:, 0] != solimp[:, 1]).any() and (solimp[:, 2] > 0).all())


EFFECT = Effect(
    about="depth over which contacts reach their full stiffness is replaced, of other geoms in proportion",
    advice=Advice(
        "Let contacts with the object reach full stiffness over {x}",
        "{raw} as the third number of solimp of the object's <geom>s, and in proportion of those that touch it",
    ),
    traits=frozenset({"simulator"}),
    parameters=(
        Parameter(
            "width_m",
            "m",
            scaled_bounds(_nominal_width, 0.02, 50.0),
            scaled_probes(_nominal_width, 0.15, 0.5, 2.0, 8.0),
            scaled_spans(_nominal_width, (0.05, 0.15), (5.0, 20.0)),
            "MuJoCo manual, solimp: 1 mm is a default; models in use have 0.1 to 20 mm",
            neutral=_nominal_width,
        ),
    ),
    acts_on="object",
    possible=_grows,
    edit=_edit,
)
