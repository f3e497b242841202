"""Position servos as DC motors: MuJoCo's `dcmotor`, and edits that serve both laws.

A `position` servo and a `dcmotor` without limit of its voltage move alike (tests hold that to 1e-9 rad). The motor
needs no activation then, so that a servo turns into one by its fields, in a private copy of the compiled model.
"""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _select
from candata.effects._select import Ids
from candata.scenes.assemble import Scene
from candata.scenes.motors import CONSTANT, KD, KP, RESISTANCE, VOLTAGE, is_motor

_GAIN, _BIAS, _DYN = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn
#: No-load speed of a servo at the supply for which its torque limit is its stall torque [rad/s]. Chosen: data sheets of
#: geared servos for hands and small arms state 45 to 75 turns a minute.
NO_LOAD_RAD_S = 6.0


def convertible(scene: Scene, ids: Ids) -> Ids:
    """Return those of some actuators that a DC motor can stand for.

    They obey gain (u - length) + constant - kv speed and have no activation. Tendons whose command has another unit,
    muscles and torque motors are left out.
    """
    model = scene.model
    gain, bias = model.actuator_gainprm[ids], model.actuator_biasprm[ids]
    is_affine = (model.actuator_gaintype[ids] == _GAIN.mjGAIN_FIXED) & (
        model.actuator_biastype[ids] == _BIAS.mjBIAS_AFFINE
    )
    is_direct = (model.actuator_dyntype[ids] == _DYN.mjDYN_NONE) & (model.actuator_plugin[ids] < 0)
    is_position = (gain[:, 0] > 0) & np.isclose(gain[:, 0], -bias[:, 1], rtol=1e-12, atol=0) & ~bias[:, 3:].any(1)
    return ids[is_affine & is_direct & is_position]


def saturating(scene: Scene, ids: Ids) -> Ids:
    """Return those of some actuators that are `convertible` and have a torque limit, taken as the stall torque."""
    ids, model = convertible(scene, ids), scene.model
    return ids[model.actuator_forcelimited[ids].astype(bool) & (model.actuator_forcerange[ids, 1] > 0)]


def has_saturating(scene: Scene) -> bool:
    """Tell whether a DC motor with a limit of its voltage can stand for one of the servos."""
    return len(saturating(scene, _select.actuators(scene, None))) > 0


def stall_slope(scene: Scene, element: str | None = None) -> float:
    """Return by how much the torque of the fingers' servos falls with speed [N m s/rad; N s/m of jaws on rails].

    Of `element` where one is given: the median torque limit over the usual no-load speed.
    """
    return _select.drive_torque(scene, element) / (NO_LOAD_RAD_S * _select.drive_reach(scene, element))


def convert(model: mujoco.MjModel, ids: Ids) -> None:
    """Turn position servos into DC motors that move alike; those that are motors stay.

    A volt stands for 1 N m of stall torque. A constant of the law, as of an encoder that is off, moves into the range
    of the command (see `simulate.world`).
    """
    for a in ids[~is_motor(model, ids)]:
        kp, (constant, _, speed_gain) = model.actuator_gainprm[a, 0], model.actuator_biasprm[a, :3]
        model.actuator_ctrlrange[a] += constant / kp
        model.actuator_gaintype[a], model.actuator_biastype[a] = _GAIN.mjGAIN_DCMOTOR, _BIAS.mjBIAS_DCMOTOR
        model.actuator_dyntype[a], model.actuator_actearly[a] = _DYN.mjDYN_DCMOTOR, True
        for parameters in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_dynprm):
            parameters[a] = 0
        model.actuator_gainprm[a, [RESISTANCE, CONSTANT, KP, KD]] = 1, 1, kp, -speed_gain


def set_stall_share(model: mujoco.MjModel, scene: Scene, ids: Ids, share: float) -> None:
    """Let the stall torque of servos be a share of the nominal torque limit, and the no-load speed with it.

    Source: MuJoCo XML reference, "dcmotor/controller": the voltage R/K torque + K speed is clamped to +-Vmax, so that
    the torque is within (K/R) (+-Vmax - K speed). With R = K, K/R is 1 and K the slope K^2/R of that limit.
    """
    _limit_voltage(model, scene, ids)
    model.actuator_gainprm[ids, VOLTAGE] = share * scene.model.actuator_forcerange[ids, 1]


def set_slope(model: mujoco.MjModel, scene: Scene, ids: Ids, slope: float) -> None:
    """Let the largest torque of servos fall with speed by `slope` [N m s/rad; N s/m of slides], see above."""
    _limit_voltage(model, scene, ids)
    model.actuator_gainprm[ids, RESISTANCE] = model.actuator_gainprm[ids, CONSTANT] = slope


def _limit_voltage(model: mujoco.MjModel, scene: Scene, ids: Ids) -> None:
    """Turn servos that are no motors yet into ones of the nominal stall torque and the usual no-load speed."""
    ids = ids[~is_motor(model, ids)]
    convert(model, ids)
    limit = scene.model.actuator_forcerange[ids, 1]
    slope = limit / np.array([_no_load_speed(scene, a) for a in ids.tolist()], float)
    model.actuator_gainprm[ids, RESISTANCE] = model.actuator_gainprm[ids, CONSTANT] = slope
    model.actuator_gainprm[ids, VOLTAGE] = limit


def _no_load_speed(scene: Scene, actuator: int) -> float:
    """Return the usual no-load speed of a servo in units of its length a second, all its joints alike."""
    joint_names = [scene.file.joints[i] for i in np.flatnonzero(np.isin(scene.joint_ids, list(scene.levers[actuator])))]
    lever = sum(abs(v) for v in scene.levers[actuator].values())
    return float(NO_LOAD_RAD_S * lever * _select.drive_reach(scene, joint_names[0]))


def scale_stiffness(model: mujoco.MjModel, ids: Ids, factor: float) -> None:
    """Scale the whole position law kp (u - q - offset) of servos; the velocity gain stays."""
    motors, others = ids[is_motor(model, ids)], ids[~is_motor(model, ids)]
    model.actuator_gainprm[motors, KP] *= factor
    model.actuator_gainprm[others, 0] *= factor
    model.actuator_biasprm[others, :2] *= factor


def scale_damping(model: mujoco.MjModel, ids: Ids, factor: float) -> None:
    """Scale the velocity gain of servos; the position gain stays."""
    motors, others = ids[is_motor(model, ids)], ids[~is_motor(model, ids)]
    model.actuator_gainprm[motors, KD] *= factor
    model.actuator_biasprm[others, 2] *= factor


def shift_length(model: mujoco.MjModel, actuator: int, change: float) -> None:
    """Let a servo see its length larger by `change`: kp (u - length - change)."""
    if is_motor(model, np.array([actuator]))[0]:
        model.actuator_ctrlrange[actuator] -= change
    else:
        model.actuator_biasprm[actuator, 0] += model.actuator_biasprm[actuator, 1] * change
