"""Contacts are softer or stiffer than modelled."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _select
from candata.effects._contract import Array, Bounds, Effect, Parameter, scaled, scaled_spans
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the time constant of solref; a pair mixes both geoms, so both sides take it."""
    ids = list(_select.contact_geoms(scene))
    solref = model.geom_solref[ids]
    # Direct form (-stiffness, -damping) becomes the time-constant form at critical damping.
    ratio = np.where(solref[:, 0] > 0, solref[:, 1], 1.0)
    model.geom_solref[ids] = np.stack([np.full(len(ids), x[0]), ratio], axis=1)


EFFECT = Effect(
    about="time constant of contacts with the object is replaced",
    parameters=(
        Parameter(
            "timeconst_s",
            "s",
            # Below two physics steps MuJoCo itself refuses to be stiffer (refsafe).
            lambda scene: Bounds(2 * scene.model.opt.timestep, 0.25),
            scaled(_select.contact_timeconst, 0.5, 1.8, 3.0, 5.0),
            scaled_spans(_select.contact_timeconst, (2.0, 5.0)),
            "soft fingertips and wood differ by an order of magnitude in stiffness",
            neutral=_select.contact_timeconst,
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
)
