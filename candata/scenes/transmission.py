"""The joints that an actuator pulls, and by which lever: a joint, or every joint of a fixed tendon."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco

_JOINT = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}


def driven_joints(model: mujoco.MjModel, actuators: Iterable[int]) -> dict[int, int]:
    """Return the joint id of each actuator id that drives a joint; actuators of tendons and bodies drive none."""
    return {a: int(model.actuator_trnid[a, 0]) for a in actuators if int(model.actuator_trntype[a]) in _JOINT}


def levers(model: mujoco.MjModel, actuators: Iterable[int]) -> dict[int, dict[int, float]]:
    """Return for each actuator id the joint ids that it pulls with their levers: its length for each unit of a joint.

    An actuator of a joint pulls that by its gear, one of a fixed tendon every joint of the tendon by gear and
    coefficient (MuJoCo manual, "Actuation model"); others, as over the sites of a spatial tendon, none.
    """
    ids = list(actuators)
    gear = model.actuator_gear[:, 0]
    levers_of = {a: {joint: float(gear[a])} for a, joint in driven_joints(model, ids).items()}
    for a in ids:
        if model.actuator_trntype[a] != mujoco.mjtTrn.mjTRN_TENDON:
            continue
        tendon = int(model.actuator_trnid[a, 0])
        start = int(model.tendon_adr[tendon])
        wraps = range(start, start + int(model.tendon_num[tendon]))
        if all(model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT for w in wraps):
            levers_of[a] = {int(model.wrap_objid[w]): float(gear[a] * model.wrap_prm[w]) for w in wraps}
    return levers_of
