"""The position laws of servos: what they take at each physics step where effects change how they answer an error."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.scenes import Scene
from candata.scenes.motors import affine_law

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ServoLaws:
    """Position laws gain u + slope length + offset of A actuators in n simulations.

    Attributes
    ----------
    lowest, highest : (n, A) float64
        Commands that the actuators take.
    lever : (A, nq) float64
        Length of each actuator for each coordinate; zero for one that pulls no joint.
    slope, offset : (n, A) float64
        Of the law, over its gain; NaN for an actuator without a position law.
    """

    lowest: Array
    highest: Array
    lever: Array
    slope: Array
    offset: Array

    def idle(self, qpos: Array) -> Array:
        """Return the commands `(n, A)` at which the laws give nothing at `qpos (n, nq)`; NaN where there is no law."""
        return -(self.slope * (qpos @ self.lever.T) + self.offset)


def servo_laws(scene: Scene, models: Sequence[mujoco.MjModel]) -> ServoLaws:
    """Return the laws of the scene's actuators in the worlds' models."""
    ids = scene.actuator_ids
    lever = np.zeros((len(ids), scene.model.nq))
    for row, a in enumerate(ids.tolist()):
        for joint, length in scene.levers.get(a, {}).items():
            lever[row, scene.model.jnt_qposadr[joint]] = length
    laws = [affine_law(m, ids) for m in models]
    gain = np.stack([gains for gains, _ in laws])
    offset, slope = (np.stack([bias[:, term] for _, bias in laws]) for term in (0, 1))
    scale = np.where((gain > 0) & (slope < 0) & lever.any(1), gain, np.nan)
    ranges = np.stack([m.actuator_ctrlrange[ids] for m in models])
    is_limited = np.stack([m.actuator_ctrllimited[ids] for m in models]).astype(bool)
    return ServoLaws(
        lowest=np.where(is_limited, ranges[..., 0], -np.inf),
        highest=np.where(is_limited, ranges[..., 1], np.inf),
        lever=lever,
        slope=slope / scale,
        offset=offset / scale,
    )


def without_command_limits(models: Sequence[mujoco.MjModel]) -> list[mujoco.MjModel]:
    """Return copies of models, one for each that differs, that take any command: the idle one may lie past a limit."""
    copies = {id(m): copy.copy(m) for m in models}
    for model in copies.values():
        model.actuator_ctrllimited[:] = False
    return [copies[id(m)] for m in models]
