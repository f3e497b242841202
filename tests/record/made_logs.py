"""Logs and files beside them, made by hand: a hand that swings, a wrist, a tracked object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from candata.record.calibration import Calibration
from candata.record.companions import Companion, RecordedStream
from candata.record.import_recipe import ImportRecipe
from candata.record.logs import Log, LogMeta
from candata.schema.scene import SceneFile

START = 1_760_000_000_000_000_000
TIPS, JOINTS = ("thumb", "index"), ("j0", "j1", "j2")
RECIPE = ImportRecipe(episode="run")


def make_log(seconds: float = 10.0, rate_hz: float = 83.0, reply_ns: int = 1_100_000, **changed) -> Log:
    """A hand that swings each joint at its own speed; commands lead by nothing, forces rest at 1 count."""
    n = round(seconds * rate_hz)
    command_ns = START + np.round(np.arange(n) * 1e9 / rate_hz).astype(np.int64)
    state_ns = command_ns + reply_ns
    meta = LogMeta(
        device="test",
        joint_names=JOINTS,
        fingertip_names=TIPS,
        taxels=4,
        newton_per_count=0.1,
        count_low=(-128, -128, 0),
        count_high=(127, 127, 255),
        rate_hz=rate_hz,
    )
    bias = np.ones((2, 3))
    rest = Calibration(bias, np.zeros((2, 4, 3)), round(3 * rate_hz), 3.0, np.zeros((2, 3)), np.zeros(3))
    counts = np.ones((n, 2, 3), np.int16)
    taxels = np.zeros((n, 2, 4, 3), np.int16)
    taxels[..., 0, 0] = (np.arange(n) % 100)[:, None]
    taxels[:, 1, 1, 1] = 7
    fields = {
        "meta": meta,
        "calibration": rest,
        "state_time_ns": state_ns,
        "joint_position": swing(state_ns),
        "motor_current": np.zeros((n, 3)),
        "force_counts": counts,
        "taxel_counts": taxels,
        "command_time_ns": command_ns,
        "joint_target": swing(command_ns),
        "statistics": (),
        "sha256": "0" * 64,
    }
    return Log(**{**fields, **changed})


def swing(time_ns) -> np.ndarray:
    return np.sin(((time_ns - START) * 1e-9)[:, None] * [1.0, 2.0, 3.0])


def pose_stream(
    rate_hz: float = 60.0, first_s: float = 0.0, last_s: float = 10.0, channel: str = "object_pose"
) -> RecordedStream:
    time_ns = START + np.round(np.arange(first_s, last_s, 1 / rate_hz) * 1e9).astype(np.int64)
    pose = np.zeros((len(time_ns), 7))
    pose[:, 0], pose[:, 3] = (time_ns - START) * 1e-9, 1.0
    return RecordedStream(channel, (), time_ns, pose, "poses.parquet")


def beside(*streams: RecordedStream) -> Companion:
    return Companion("map.yaml", streams, "1" * 64)


def wrist(channel: str = "joint_position", names=("w0", "w1")) -> RecordedStream:
    time_ns = START + np.arange(0, 10_000, 10) * 1_000_000
    return RecordedStream(
        channel, names, time_ns, np.tile([5.0, 6.0], (len(time_ns), 1))[:, : len(names)], "wrist.parquet"
    )


def scene(**changed) -> SceneFile:
    fields = {"model": "s.xml", "rate_hz": 80, "joints": ("w0", "w1", *JOINTS), "actuators": ("w0", "w1", *JOINTS)}
    return SceneFile.model_validate({**fields, "fingertips": TIPS[::-1], **changed})


def without(log: Log, lost: np.ndarray, commands: bool = False) -> Log:
    """The log without the state frames (or the commands) in `lost`."""
    if commands:
        return replace(log, command_time_ns=log.command_time_ns[~lost], joint_target=log.joint_target[~lost])
    names = ("state_time_ns", "joint_position", "motor_current", "force_counts", "taxel_counts")
    return replace(log, **{name: getattr(log, name)[~lost] for name in names})
