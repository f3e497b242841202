"""A servo on a weak supply, stepped by plain MuJoCo: the stand-in world of what follows a recorded supply."""

from __future__ import annotations

import mujoco
import numpy as np

#: Supply without load [V], torque from which it sags [N m], and by how much beyond that [V/(N m)]: to three quarters
#: at the stall torque of the pendulum's servo.
SUPPLY_V, SAGS_FROM_NM, SAG_V_NM = 7.4, 0.13, 10.0


def play_on_weak_supply(scene, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and supply `(T,)` [rad, V] of a servo without a current loop whose supply sags under its load.

    The supply over that without load scales the voltage that the controller gives, and its largest: gain and stall
    torque of `<position>`.
    """
    model = scene.model.__copy__()
    data = mujoco.MjData(model)
    gain, bias, limit = (
        field[0].copy() for field in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange)
    )
    substeps = round(1 / scene.file.rate_hz / model.opt.timestep)
    positions, supply = [], []
    for command in commands:
        volts = SUPPLY_V - SAG_V_NM * max(abs(data.actuator_force[0]) - SAGS_FROM_NM, 0)
        positions.append(data.qpos[0])
        supply.append(volts)
        share = volts / SUPPLY_V
        model.actuator_gainprm[0], model.actuator_forcerange[0] = share * gain, share * limit
        model.actuator_biasprm[0, :3] = share * bias[0], share * bias[1], bias[2]
        data.ctrl[:] = command
        for _ in range(substeps):
            mujoco.mj_step(model, data)
    return np.array(positions), np.array(supply)
