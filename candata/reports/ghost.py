"""A ghost in a picture: some geoms of a model once more, elsewhere, seen through."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.reports.camera import SHOWN_GROUPS, SIGNS

#: Colour of a ghost, and how much of it hides what lies behind (of 1). Chosen: hands, cans and tables are rarely pink.
COLOUR, OPACITY = (0.90, 0.10, 0.65), 0.5
#: How far a ghost must stand from its geom, and before what is solid, to be seen [m]. Chosen: where both agree as well
#: as trackers measure, the picture stays plain.
CLEARANCE_M = 0.004
#: Geom group that nothing shows, by MuJoCo's default visualisation options.
HIDDEN_GROUP = mujoco.mjNGROUP - 1


@dataclass(frozen=True)
class Ghost:
    """What is shown as a ghost.

    Attributes
    ----------
    geoms : tuple of int
        Ids of its geoms.
    qpos : (K, nq) float64
        Positions of the model in which they are, a row a picture; a row that is not finite shows none.
    """

    geoms: tuple[int, ...]
    qpos: NDArray[np.float64]

    def part(self, rows: slice) -> Ghost:
        """Return the ghost of some of the pictures."""
        return Ghost(self.geoms, self.qpos[rows])


def ghost_model(model: mujoco.MjModel, ghost: Ghost) -> mujoco.MjModel:
    """Return a copy of the model that shows the ghost's geoms alone, in its colour."""
    alone = copy.copy(model)
    is_ghost = np.isin(np.arange(model.ngeom), ghost.geoms) & (model.geom_group < SHOWN_GROUPS)
    alone.geom_group[~is_ghost] = HIDDEN_GROUP
    alone.geom_rgba[is_ghost] = (*COLOUR, 1.0)
    alone.geom_matid[is_ghost] = -1
    return alone


def show_parted(alone: mujoco.MjModel, geoms: NDArray[np.intp], ghost_data: mujoco.MjData, data: mujoco.MjData) -> None:
    """Show of a ghost only the geoms that stand apart from where `data` has them, in its model `alone`.

    A surface that is seen at a flat angle lies far before another that is hardly lower, so depth alone does not tell.
    """
    corners = alone.geom_aabb[geoms, None, :3] + SIGNS * alone.geom_aabb[geoms, None, 3:]
    ghost_places, places = (
        state.geom_xpos[geoms, None] + np.einsum("gij,gcj->gci", state.geom_xmat[geoms].reshape(-1, 3, 3), corners)
        for state in (ghost_data, data)
    )
    is_apart = np.linalg.norm(ghost_places - places, axis=2).max(axis=1) > CLEARANCE_M
    alone.geom_group[geoms] = np.where(is_apart, 0, HIDDEN_GROUP)


def ghost_geoms(alone: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the ids of the geoms that the model of a ghost shows."""
    return np.flatnonzero(alone.geom_group != HIDDEN_GROUP)
