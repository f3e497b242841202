"""The places of MuJoCo's `dcmotor` in a compiled model, and the law that it obeys until its voltage is limited."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

Ids = Sequence[int] | NDArray[np.int64]
#: Places in `actuator_gainprm` of a motor: resistance, torque constant, kp, ki, kd, Vmax. Source: what MuJoCo 4.0
#: compiles `dcmotor` to; a test compares.
RESISTANCE, CONSTANT, KP, KI, KD, VOLTAGE = 0, 1, 4, 5, 6, 7
#: Place in `actuator_dynprm` of the farthest that the set point moves a second.
SLEW = 7
#: Input of a motor that takes a position (`mjtCtrlInput`).
_POSITION = int(mujoco.mjtCtrlInput.mjINPUT_POS)


def is_motor(model: mujoco.MjModel, ids: Ids) -> NDArray[np.bool_]:
    """Return `(n,)` which actuators are DC motors."""
    return np.asarray(model.actuator_gaintype[ids] == mujoco.mjtGain.mjGAIN_DCMOTOR)


def is_position_motor(model: mujoco.MjModel, ids: Ids) -> NDArray[np.bool_]:
    """Return `(n,)` which actuators are DC motors whose controller follows a position, without an integral part."""
    follows = (model.actuator_ctrlspec[ids] == _POSITION) & (model.actuator_gainprm[ids, KI] == 0)
    return is_motor(model, ids) & follows


def affine_law(model: mujoco.MjModel, ids: Ids) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return `(gain (n,), bias (n, 3))` of force = gain u + bias (1, length, speed), before limits.

    A DC motor that follows a position obeys kp (u - length) - kd speed (MuJoCo XML reference, "dcmotor/controller").
    What other actuators hold in the same places is returned as it is.
    """
    gain, bias = model.actuator_gainprm[ids, 0].copy(), model.actuator_biasprm[ids, :3].copy()
    motors = is_position_motor(model, ids)
    kp, kd = model.actuator_gainprm[ids][motors][:, [KP, KD]].T
    gain[motors] = kp
    bias[motors] = np.stack([np.zeros_like(kp), -kp, -kd], axis=1)
    return gain, bias


def has_affine_law(model: mujoco.MjModel, ids: Ids) -> NDArray[np.bool_]:
    """Return `(n,)` for which actuators `affine_law` has a bias that counts."""
    affine = model.actuator_biastype[ids] == mujoco.mjtBias.mjBIAS_AFFINE
    return np.asarray(affine | is_position_motor(model, ids))
