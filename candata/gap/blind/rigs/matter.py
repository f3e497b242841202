"""Whether a planted cause matters: what a plain replay without it says, against what was recorded with it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.blind.rigs.design import Rig
from candata.gap.blind.rigs.player import STATE, Log, parts, play
from candata.gap.blind.rigs.readings import Planted, Reading, ideal
from candata.gap.blind.rigs.recording import Outline, nominal

Array = NDArray[np.float64]
#: Length of the blocks whose means are compared [s], and how many times a channel's noise their rms is off by where a
#: cause matters. Chosen: plain to see in a plot, so that no miss is a matter of luck.
BLOCK_S, CLEAR = 0.05, 2.0


def matters(rig: Rig, world: Planted, some: Sequence[Outline], played: Sequence[Log]) -> bool:
    """Tell whether a cause is clear in some channel of a rig's recordings."""
    return worth(rig, world, some, played) >= CLEAR


def worth(rig: Rig, world: Planted, some: Sequence[Outline], played: Sequence[Log]) -> float:
    """Return the largest rms, over channels, of block means between recordings and replays without the cause.

    In units of the channel's noise. A replay starts where the first reading says, with the true speeds and everything
    that is not read, and is given the same commands.

    Parameters
    ----------
    rig : Rig
    world : Planted
        The world of the recordings.
    some : sequence of Outline
        What was played.
    played : sequence of Log
        What an ideal rig recorded, leads included.
    """
    plain = nominal(rig)
    gaps: dict[str, list[Array]] = {}
    for one, log in zip(some, played, strict=True):
        read = world.read(log)
        state = _read_state(rig, log.states[one.lead], read, one.lead)
        replay = play(plain, rig.file, state, one.actions[one.lead :])
        seen = Reading(
            read.joint[one.lead :], None if read.pose is None else read.pose[one.lead :], read.force[one.lead :]
        )
        for name, gap in _gaps(rig, seen, ideal(replay)).items():
            gaps.setdefault(name, []).append(_blocks(gap, rig.file.rate_hz))
    found = [float(np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)).max()) for parts in gaps.values()]
    return max(found) if np.isfinite(found).all() else 0.0


def _read_state(rig: Rig, state: Array, read: Reading, row: int) -> Array:
    """Return a state with joints and pose as they were read."""
    model = nominal(rig).model
    data, where = mujoco.MjData(model), parts(model, rig.file)
    mujoco.mj_setState(model, data, state, STATE)
    data.qpos[where.qpos] = read.joint[row]
    if read.pose is not None:
        data.qpos[where.object_qpos : where.object_qpos + 7] = read.pose[row]
    out = np.zeros(len(state))
    mujoco.mj_getState(model, data, out, STATE)
    return out


def _gaps(rig: Rig, one: Reading, other: Reading) -> dict[str, Array]:
    """Return the differences of two readings by channel `(T, n)`, in units of the channel's noise.

    The first force is left out: a replay has none before its first step.
    """
    slides = np.array([next(d.servo.slides for d in rig.drives if d.servo.joint == j) for j in rig.file.joints])
    noise = np.where(slides, rig.slide_noise_m, rig.noise.joint_position)
    out = {"joint": (one.joint - other.joint) / noise}
    if rig.file.fingertips and rig.thing is not None:
        size = (len(one.force), -1)
        force = (one.force - other.force).reshape(size) / rig.noise.fingertip_force
        force[0] = 0.0
        out["force"] = force
    if one.pose is not None and other.pose is not None:
        out["place"] = (one.pose[:, :3] - other.pose[:, :3]) / rig.noise.object_pose[0]
        cosine = np.clip(np.abs((one.pose[:, 3:] * other.pose[:, 3:]).sum(1)), 0, 1)
        out["turn"] = 2 * np.arccos(cosine)[:, None] / rig.noise.object_pose[1]
    return out


def _blocks(gap: Array, rate_hz: float) -> Array:
    """Return means over blocks of rows `(B, n)`."""
    rows = max(round(BLOCK_S * rate_hz), 1)
    whole = len(gap) // rows * rows
    return gap[:whole].reshape(-1, rows, gap.shape[1]).mean(1)
