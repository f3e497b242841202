"""What sensors say of a random small scene: ideal readings, noise on top, columns of a table, episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.formats import table
from candata.gap.blind.rigs.design import Rig
from candata.gap.blind.rigs.player import Log, World
from candata.gap.blind.rigs.recording import Outline
from candata.schema.episode import Episode
from candata.schema.scene import TableMap

Array = NDArray[np.float64]
POSE = ("px", "py", "pz", "qw", "qx", "qy", "qz")


class Reading(NamedTuple):
    """Readings of one episode: joints `(T, J)`, pose `(T, 7)` or None, forces `(T, F, 3)`."""

    joint: Array
    pose: Array | None
    force: Array


class Planted(NamedTuple):
    """A world and what its sensors make of a log, its lead included."""

    world: World
    read: Callable[[Log], Reading]


def ideal(log: Log) -> Reading:
    """Return readings without any fault."""
    return Reading(log.joint, log.pose, log.force)


def episode_reading(planted: Planted, log: Log, lead: int) -> Reading:
    """Return the ideal sensors' readings from the row on at which an episode begins."""
    found = planted.read(log)
    return Reading(found.joint[lead:], None if found.pose is None else found.pose[lead:], found.force[lead:])


def noisy(rig: Rig, exact: Reading, rng: np.random.Generator) -> Reading:
    """Return readings with the scene's true noise: Gaussian, a small turn on orientations, forces in steps."""
    slides = np.array([next(d.servo.slides for d in rig.drives if d.servo.joint == j) for j in rig.file.joints])
    joint_noise = np.where(slides, rig.slide_noise_m, rig.noise.joint_position)
    joint = exact.joint + joint_noise * rng.standard_normal(exact.joint.shape)
    force = exact.force + rig.noise.fingertip_force * rng.standard_normal(exact.force.shape)
    if rig.noise.force_step:
        force = np.round(force / rig.noise.force_step) * rig.noise.force_step
    if exact.pose is None:
        return Reading(joint, None, force)
    place, turn = rig.noise.object_pose
    pose = exact.pose.copy()
    pose[:, :3] += place * rng.standard_normal((len(pose), 3))
    for row in pose:
        angle, small = turn * rng.standard_normal(3), np.zeros(4)
        size = float(np.linalg.norm(angle))
        mujoco.mju_axisAngle2Quat(small, angle / max(size, 1e-12), size)
        out = np.zeros(4)
        mujoco.mju_mulQuat(out, row[3:], small)
        row[3:] = out / np.linalg.norm(out)
    return Reading(joint, pose, force)


def episodes(rig: Rig, some: Sequence[Outline], found: Sequence[Reading]) -> list[Episode]:
    """Return the episodes of a case, as the import of a table of theirs makes them."""
    file = rig.file
    joints, motors = [f"q_{j}" for j in file.joints], [f"a_{a}" for a in file.actuator_names]
    tips = [tuple(f"f{i}{axis}" for axis in "xyz") for i in range(len(file.fingertips))]
    channels: dict[str, str | tuple[str | tuple[str, ...], ...]] = {
        "joint_position": tuple(joints),
        "action": tuple(motors),
    }
    if found[0].pose is not None:
        channels["object_pose"] = POSE
    if tips:
        channels["fingertip_force"] = tuple(tips)
    columns: dict[str, Array] = {}
    blocks = []
    for i, (one, reading) in enumerate(zip(some, found, strict=True)):
        rows = len(reading.joint)
        parts = [
            np.full((rows, 1), i),
            np.arange(rows)[:, None] / file.rate_hz,
            reading.joint,
            one.actions[one.lead : one.lead + rows],
        ]
        parts += [] if reading.pose is None else [reading.pose]
        parts += [reading.force.reshape(rows, -1)] if tips else []
        blocks.append(np.concatenate(parts, axis=1))
    names = ["episode", "t", *joints, *motors, *(POSE if found[0].pose is not None else ()), *sum(tips, ())]
    whole = np.concatenate(blocks)
    columns = {name: whole[:, i] for i, name in enumerate(names)}
    mapping = TableMap(
        file="episodes", source="real", episode="episode", time_s="t", rate_hz=file.rate_hz, channels=channels
    )
    return list(table.episodes(mapping, columns, Path("episode")))
