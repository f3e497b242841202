"""Contacts are softer or stiffer than modelled."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _contact, _select
from candata.effects._contract import Advice, Array, Bounds, Effect, Parameter, scaled_probes, scaled_spans
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the time constant of solref; a pair mixes both geoms, so both sides take it, or one leads."""
    _contact.change_solref(model, scene, element, lambda solref: _with_timeconst(solref, x[0]))


def _with_timeconst(solref: Array, timeconst_s: float) -> Array:
    """Return solref `(m, 2)` with another time constant and its own damping ratio."""
    return np.stack([np.full(len(solref), timeconst_s), _contact.time_form(solref)[:, 1]], axis=1)


EFFECT = Effect(
    about="time constant of contacts with the object is replaced",
    advice=Advice(
        "Set the time constant of contacts at {surface} to {x}",
        "{raw} as the first number of solref of the <geom>s that touch, the second as it is",
    ),
    traits=frozenset({"contact_spring"}),
    parameters=(
        Parameter(
            "timeconst_s",
            "s",
            # Below two physics steps MuJoCo itself refuses to be stiffer (refsafe).
            lambda scene: Bounds(2 * scene.model.opt.timestep, 0.25),
            scaled_probes(_select.contact_timeconst, 0.5, 1.4, 2.5, 5.0),
            scaled_spans(_select.contact_timeconst, (2.0, 5.0)),
            "soft fingertips and wood differ by an order of magnitude in stiffness",
            neutral=_select.contact_timeconst,
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
    elements=_contact.names,
)
