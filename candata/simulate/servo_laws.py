"""Position laws of servos: what they take where effects change how they answer an error, and their strength."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.scenes import Scene
from candata.scenes.motors import KP, VOLTAGE, affine_law, is_position_motor

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


class DriveScales:
    """Position gains and torque limits of the scene's position servos, which change from step to step.

    The voltage of a servo without a current loop is a share of its supply: its torque at a position error and its stall
    torque are proportional to the supply, back-EMF is not. Source: torque (K/R)(V g e - K w), |V g e| <= V d_max.

    Parameters
    ----------
    scene : Scene
    models : sequence of n MjModel
        Private to each simulation; what they hold now is strength 1.
    """

    def __init__(self, scene: Scene, models: Sequence[mujoco.MjModel]) -> None:
        self._ids, self._usual = scene.actuator_ids, []
        for model in models:
            gain, bias = affine_law(model, self._ids)
            follows = ((gain > 0) & (bias[:, 1] < 0))[:, None]
            is_motor = is_position_motor(model, self._ids)[:, None]
            places = np.arange(mujoco.mjNGAIN)
            scaled = (
                (model.actuator_gainprm, follows & np.where(is_motor, np.isin(places, (KP, VOLTAGE)), places == 0)),
                (model.actuator_biasprm, follows & ~is_motor & (np.arange(mujoco.mjNBIAS) < 2)),
                (model.actuator_forcerange, np.repeat(follows, 2, axis=1)),
            )
            self._usual.append([(field, is_scaled, field[self._ids].copy()) for field, is_scaled in scaled])

    def set(self, strength: Array) -> None:
        """Scale the servos of each model by `strength (n, A)`."""
        for fields, factor in zip(self._usual, strength, strict=True):
            for field, is_scaled, usual in fields:
                field[self._ids] = np.where(is_scaled, factor[:, None] * usual, usual)


def without_command_limits(models: Sequence[mujoco.MjModel]) -> list[mujoco.MjModel]:
    """Return copies of models, one for each that differs, that take any command: the idle one may lie past a limit."""
    copies = {id(m): copy.copy(m) for m in models}
    for model in copies.values():
        model.actuator_ctrllimited[:] = False
    return [copies[id(m)] for m in models]
