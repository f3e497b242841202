"""50 motions of a real SO-101 arm: six joints, commands, motor current as effort, 50 Hz, Apache-2.0.

Repository isaac-sim2real/sage. Servos: Feetech STS3215, 12 V, gains P 16, I 0, D 32 by the collector's source.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.fetch import PublicDataset
from candata.fetch._prepared_table import Columns, PreparedTable, runs, stamps_ns
from candata.schema.episode import Episode, EpisodeMeta

#: Rate of the stamps, 20.06 ms apart with a jitter of 0.6 ms: they are kept.
RATE_HZ = 49.85
JOINTS = ("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw")
#: Jaw angle over its servo's, by which the jaw's velocity, reported of the servo, is scaled: the angle's steps are
#: 0.6566 mrad in this table, the servo's 1/4096 of a turn.
JAW_GEAR = 0.6566e-3 / (2 * np.pi / 4096)
#: Channel to the columns it is made of, {} for the joint's number.
_CHANNELS = {
    "joint_position": "q{}_rad",
    "joint_velocity": "v{}",
    "joint_effort": "effort{}",
    "action": "u{}_rad",
}


def episodes(columns: Columns) -> Iterator[Episode]:
    """Yield one episode a motion; `joint_effort` is from the motor current, in a unit that the source does not give."""
    for rows in runs(columns["motion"]):
        motion = str(columns["motion"][rows[0]])
        arrays = {
            channel: np.stack([columns[name.format(k)][rows] for k in range(len(JOINTS))], axis=1)
            for channel, name in _CHANNELS.items()
        }
        arrays["joint_velocity"] = arrays["joint_velocity"] * np.array([1, 1, 1, 1, 1, JAW_GEAR])
        yield Episode(
            EpisodeMeta(
                id=motion,
                source="real",
                rate_hz=RATE_HZ,
                scene="so101_arm",
                task=motion,
                joint_names=JOINTS,
                actuator_names=JOINTS,
                labels={"motion": motion, "kp": 16, "ki": 0, "kd": 32, "supply_V": 12.0},
                unscaled=("joint_effort",),
            ),
            {"time_ns": stamps_ns(columns["time_s"][rows]), **arrays},
        )


TABLE = PreparedTable(
    file="so101_motions.parquet",
    sha256="7e38b091fb473aba0c0ff692281efb57243b2b402edbd1a5e2e1177290087706",
    origin="github.com/isaac-sim2real/sage, output/real/so101 at 4ffd2627",
    layout="three CSV files a motion",
    episodes=episodes,
    licence_sha256="c71d239df91726fc519c6eb72d318ec65820627232b2f796219e87dcf35d0ab4",
)
SOURCE = PublicDataset(
    name="so101_motions",
    summary="50 real motions of an SO-101 arm, six joints with commands and motor current, 50 Hz",
    origin=TABLE.origin,
    licence="Apache-2.0",
    from_folder=TABLE.from_folder,
    download=TABLE.download,
)
