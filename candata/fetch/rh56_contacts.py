"""800 contacts of one finger of an Inspire RH56 hand with a surface, speed by force limit, 80 Hz, Apache-2.0 declared.

Repository correlllab/rh56_controller. Speed and force limit are labelled, true causes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.fetch import PublicDataset
from candata.fetch._prepared_table import Columns, PreparedTable, on_even_rows, runs, stamps_ns
from candata.formats._assemble import derive_contact
from candata.schema.episode import Episode, EpisodeMeta
from candata.units import to_si

RATE_HZ = 80.0
#: Longest step between two stamps where none is missing [s]. Steps are 12.5 ms, and 25 ms where two threads of the
#: source's program read the hand in turns; 37 ms and more where it was being commanded.
MAX_GAP_S = 0.03
JOINT, FINGERTIP = ("middle",), ("middle_tip",)
#: Registers of the finger's whole stroke: 0 closed, 1000 open (Inspire RH56 manual, "ANGLE_ACT").
STROKE = 1000.0
#: Register that each stage sends the finger to (experiment_data/hybrid/test.py of the repository); it is held until the
#: next stage, also while nothing is logged.
TARGET = {"open": 1000.0, "approach": 700.0, "contact": 0.0}


def episodes(columns: Columns) -> Iterator[Episode]:
    """Yield one episode a trial: it opens, waits unlogged for about a second, and closes on the surface.

    `joint_position` and `action` are strokes, 0 closed and 1 open. `fingertip_force` is the motor's estimate, along the
    fingertip's z alone: the surface presses against it. The source's `Middle_Force_N` holds grams and is not read.
    """
    trial_keys = np.char.add(
        np.char.add(_texts(columns["speed"]), "/"),
        np.char.add(np.char.add(_texts(columns["force_limit_g"]), "/"), _texts(columns["Trial_Index"])),
    )
    for rows in runs(trial_keys):
        yield _episode({name: values[rows] for name, values in columns.items()})


def _episode(trial: Columns) -> Episode:
    """Return the episode of a trial."""
    target = np.array([TARGET[stage] for stage in trial["Stage"]]) / STROKE
    force = np.zeros((len(target), 1, 3))
    force[:, 0, 2] = -to_si("gf") * trial["Middle_Force_g"]
    resampled = on_even_rows(
        stamps_ns(trial["Trial_Elapsed_s"]),
        {
            "joint_position": trial["Middle_Angle"][:, None] / STROKE,
            "action": target[:, None],
            "fingertip_force": force,
        },
        RATE_HZ,
        MAX_GAP_S,
        held=frozenset({"action"}),
    )
    mode, speed = str(trial["Mode"][0]), int(trial["speed"][0])
    limit_g, number = int(trial["force_limit_g"][0]), int(trial["Trial_Index"][0])
    manner = mode if mode == "hybrid" else f"{mode}{speed}"
    contact_rule = derive_contact(resampled.arrays, resampled.invalid)
    return Episode(
        EpisodeMeta(
            id=f"{manner}-limit{limit_g}-{number:02d}",
            source="real",
            rate_hz=RATE_HZ,
            scene="rh56_finger",
            task="contact",
            joint_names=JOINT,
            actuator_names=JOINT,
            fingertip_names=FINGERTIP,
            contact_rule=contact_rule,
            alignment=resampled.alignment,
            invalid_counts=resampled.invalid,
            labels={
                "mode": mode,
                "speed": speed,
                "force_limit_g": limit_g,
                "force_trigger_g": int(trial["Force_Trigger_g"][0]),
                "trial": number,
            },
        ),
        resampled.arrays,
    )


def _texts(numbers: NDArray) -> NDArray[np.str_]:
    """Return whole numbers as texts."""
    return np.asarray(numbers, np.int64).astype(str)


TABLE = PreparedTable(
    file="rh56_contacts.parquet",
    sha256="d607a4d0c27aeee620c879be1214c4153f741351407455916103cba097190124",
    origin="github.com/correlllab/rh56_controller, experiment_data/hybrid at e4ef2568",
    layout="one CSV file a setting",
    episodes=episodes,
    notice="The repository holds no licence file; its setup.py and package.xml declare Apache-2.0 "
    "(https://www.apache.org/licenses/LICENSE-2.0).",
)
SOURCE = PublicDataset(
    name="rh56_contacts",
    summary="800 real contacts of a finger of an Inspire RH56 hand, labelled speed and force limit, 80 Hz",
    origin=TABLE.origin,
    licence="Apache-2.0",
    from_folder=TABLE.from_folder,
    download=TABLE.download,
)
