"""16 runs of a pendulum on a Dynamixel XL330 servo: four gains, four trajectories, some 200 Hz, Apache-2.0.

Repository Rhoban/bam. The gain is a labelled, true cause. Its authors' friction models of such servos: "Extended
Friction Models for the Physics Simulation of Servo Actuators" (arXiv 2410.08650).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.fetch import PublicDataset
from candata.fetch._prepared_table import Columns, PreparedTable, on_even_rows, runs, stamps_ns
from candata.schema.episode import Episode, EpisodeMeta

#: Rows that the runs are put on. Recorded stamps are 5.3 ms apart, and 3.5 ms where the torque is off and nothing is
#: written to the servo.
RATE_HZ = 200.0
#: Longest step between two stamps where none is missing [s]: the longest of the set is 7.1 ms.
MAX_GAP_S = 0.008
JOINT = ("shaft",)
#: The log's name of the servo's PWM duty, a 16-bit two's complement number whose full scale is 885 counts
#: (bam/xl330/record.py of the repository; Dynamixel XL330-M288 e-manual, "Present PWM").
_WORD = 1 << 16


def episodes(columns: Columns) -> Iterator[Episode]:
    """Yield one episode a run.

    `joint_effort` is the PWM duty in counts, `supply_voltage` the servo's own reading, `torque_on` whether it drives.
    """
    for rows in runs(columns["run"]):
        run = {name: values[rows] for name, values in columns.items()}
        resampled = on_even_rows(
            stamps_ns(run["time_s"]),
            {
                "joint_position": run["position_rad"][:, None],
                "joint_velocity": run["speed"][:, None],
                "joint_effort": _signed(run["load"])[:, None],
                "action": run["goal_rad"][:, None],
                "supply_voltage": run["volts"][:, None],
                "torque_on": run["torque_on"][:, None],
            },
            RATE_HZ,
            MAX_GAP_S,
        )
        trajectory, kp = str(run["trajectory"][0]), int(run["kp"][0])
        yield Episode(
            EpisodeMeta(
                id=f"kp{kp}-{trajectory}",
                source="real",
                rate_hz=RATE_HZ,
                scene="xl330_pendulum",
                task=trajectory,
                joint_names=JOINT,
                actuator_names=JOINT,
                alignment=resampled.alignment,
                invalid_counts=resampled.invalid,
                labels={
                    "run": str(run["run"][0]),
                    "kp": kp,
                    "mass_kg": float(run["mass_kg"][0]),
                    "length_m": float(run["length_m"][0]),
                    "supply_V": float(run["supply_V"][0]),
                    "temp_C_start": float(run["temp_C"][0]),
                    "temp_C_end": float(run["temp_C"][-1]),
                },
                unscaled=("joint_effort",),
            ),
            resampled.arrays,
        )


def _signed(words: NDArray) -> NDArray[np.float64]:
    """Return 16-bit two's complement numbers that were read as unsigned."""
    counts = np.asarray(words, np.float64)
    return np.where(counts >= _WORD / 2, counts - _WORD, counts)


TABLE = PreparedTable(
    file="xl330_pendulum.parquet",
    sha256="40a0b32262e2fb8899d1a381ac055e50cd33f8e3e9481cb8c4d68c778fcd0297",
    origin="github.com/Rhoban/bam, bam/data.bak/raw at af226046",
    layout="one JSON file a run",
    episodes=episodes,
    licence_sha256="58d1e17ffe5109a7ae296caafcadfdbe6a7d176f0bc4ab01e12a689b0499d8bd",
)
SOURCE = PublicDataset(
    name="xl330_pendulum",
    summary="16 real runs of a pendulum on a Dynamixel XL330, four labelled gains, 200 Hz",
    origin=TABLE.origin,
    licence="Apache-2.0",
    from_folder=TABLE.from_folder,
    download=TABLE.download,
)
