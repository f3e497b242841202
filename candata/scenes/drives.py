"""The kind of drive that an actuator is, and the units of its gains."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.scenes.motors import affine_law, has_affine_law, is_position_motor
from candata.scenes.transmission import driven_joints, levers

_GAIN, _BIAS, _DYN, _TRN = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn, mujoco.mjtTrn
#: Kinds that MuJoCo names itself, by their activation dynamics or their gain.
_BY_DYNAMICS = {_DYN.mjDYN_MUSCLE: "muscle", _DYN.mjDYN_DCMOTOR: "DC motor", _DYN.mjDYN_USER: "user-defined"}
_BY_GAIN = {_GAIN.mjGAIN_MUSCLE: "muscle", _GAIN.mjGAIN_DCMOTOR: "DC motor", _GAIN.mjGAIN_USER: "user-defined"}


class Units(NamedTuple):
    """Units of an actuator's stiffness, damping and effort."""

    kp: str
    kv: str
    effort: str


_HINGE_UNITS, _SLIDE_UNITS = Units("N m/rad", "N m s/rad", "N m"), Units("N/m", "N s/m", "N")


class Drive(NamedTuple):
    """The law of an actuator: kind, gains (None: it has none) and their units."""

    kind: str
    kp: float | None
    kv: float | None
    units: Units


def position_servos(model: mujoco.MjModel, actuators: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return `(n,)` which actuators are position servos, force = gain u + b0 + b1 length + ... with b1 < 0.

    Source: MuJoCo manual, "Actuation model"; an integrating one takes a velocity.
    """
    gain, bias = affine_law(model, actuators)
    direct = model.actuator_dyntype[actuators] != _DYN.mjDYN_INTEGRATOR
    return np.asarray(has_affine_law(model, actuators) & direct & (bias[:, 1] < 0) & (gain != 0))


def drive_of(model: mujoco.MjModel, actuator: int) -> Drive:
    """Return kind and gains of an actuator (MuJoCo XML reference, "actuator": the shortcuts and what they set)."""
    _, bias = affine_law(model, [actuator])
    stiffness, damping = (float(0.0 - b) for b in bias[0, 1:])
    units = _units(model, actuator)
    kind = _known_kind(model, actuator)
    if kind:
        has_gains = is_position_motor(model, [actuator])[0]
        return Drive(kind, stiffness if has_gains else None, damping if has_gains else None, units)
    if position_servos(model, np.array([actuator]))[0]:
        return Drive("position servo", stiffness, damping, units)
    affine = model.actuator_biastype[actuator] == _BIAS.mjBIAS_AFFINE
    if affine and stiffness > 0 and model.actuator_dyntype[actuator] == _DYN.mjDYN_INTEGRATOR:
        return Drive("integrated-velocity servo", stiffness, damping, units)
    if affine and stiffness == 0 and damping > 0 and model.actuator_gainprm[actuator, 0] != 0:
        return Drive("velocity servo", None, damping, units)
    if model.actuator_gaintype[actuator] == _GAIN.mjGAIN_AFFINE:
        return Drive(
            "damper" if not affine and model.actuator_gainprm[actuator, 2] < 0 else "general", None, None, units
        )
    if affine and model.actuator_biasprm[actuator, :3].any():
        return Drive("general", stiffness or None, damping or None, units)
    return Drive("torque motor" if units == _HINGE_UNITS else "force motor", None, None, units)


def _known_kind(model: mujoco.MjModel, actuator: int) -> str:
    """Return the kind of an actuator that MuJoCo names itself; empty for others."""
    if model.actuator_plugin[actuator] >= 0:
        return "plugin"
    if model.actuator_trntype[actuator] == _TRN.mjTRN_BODY:
        return "adhesion"
    dynamics, gain = model.actuator_dyntype[actuator], model.actuator_gaintype[actuator]
    return _BY_DYNAMICS.get(_DYN(dynamics), "") or _BY_GAIN.get(_GAIN(gain), "")


def _units(model: mujoco.MjModel, actuator: int) -> Units:
    """Return an actuator's units: those of turning where all that it pulls turns, else those of sliding."""
    joints = levers(model, [actuator]).get(actuator, {})
    slides = [model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE for joint in joints]
    return _HINGE_UNITS if joints and not any(slides) else _SLIDE_UNITS


def pulled_by(model: mujoco.MjModel, actuator: int) -> str:
    """Return in words what an actuator pulls: `joint index1`, `tendon jaws`."""
    target_id = int(model.actuator_trnid[actuator, 0])
    if actuator in driven_joints(model, [actuator]):
        return f"joint {model.joint(target_id).name or target_id}"
    kind = _TRN(model.actuator_trntype[actuator])
    if kind == _TRN.mjTRN_TENDON:
        return f"tendon {model.tendon(target_id).name or target_id}"
    if kind == _TRN.mjTRN_BODY:
        return f"body {model.body(target_id).name or target_id}"
    return f"site {model.site(target_id).name or target_id}"
