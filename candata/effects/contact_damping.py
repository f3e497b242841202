"""Contacts bounce more or less than modelled."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _contact, _select
from candata.effects._contract import Advice, Array, Effect, Parameter, scaled_bounds, scaled_probes, scaled_spans
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the damping ratio of solref, on both sides of a contact, or on one that leads."""
    _contact.change_solref(model, scene, element, lambda solref: _with_dampratio(solref, x[0]))


def _with_dampratio(solref: Array, ratio: float) -> Array:
    """Return solref `(m, 2)` with another damping ratio and its own time constant."""
    return np.stack([_contact.time_form(solref)[:, 0], np.full(len(solref), ratio)], axis=1)


def _nominal_dampratio(scene: Scene) -> float:
    """Return the median damping ratio of the object's geoms; critical where there is no object."""
    if not len(scene.object_geoms):
        return 1.0
    return float(np.median(_contact.time_form(scene.model.geom_solref[scene.object_geoms])[:, 1]))


EFFECT = Effect(
    about="damping ratio of contacts with the object is replaced",
    advice=Advice(
        "Set the damping ratio of contacts at {surface} to {x}",
        "{raw} as the second number of solref of the <geom>s that touch",
    ),
    traits=frozenset({"contact_spring"}),
    parameters=(
        Parameter(
            "dampratio",
            "1",
            scaled_bounds(_nominal_dampratio, 0.1, 8.0),
            scaled_probes(_nominal_dampratio, 0.25, 0.5, 2.2),
            scaled_spans(_nominal_dampratio, (0.2, 0.5), (1.8, 3.0)),
            "critical (1) is a default, not a measurement: wood and plastic bounce, foam does not",
            neutral=_nominal_dampratio,
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
    elements=_contact.names,
)
