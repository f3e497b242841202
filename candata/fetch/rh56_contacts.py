"""800 contacts of one finger of an Inspire RH56 hand with a surface, speed by force limit, 80 Hz, Apache-2.0 declared.

Repository correlllab/rh56_controller. Speed and force limit are labelled, true causes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.signal import medfilt

from candata.fetch import PublicDataset
from candata.fetch._prepared_table import Columns, PreparedTable, on_even_rows, runs, stamps_ns
from candata.formats._assemble import derive_contact
from candata.schema.channels import VALID_SUFFIX
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
#: next stage.
TARGET = {"open": 1000.0, "approach": 700.0, "contact": 0.0}
#: Rows of rest before the finger is sent. Chosen: a start at rest is read off them.
REST_ROWS = 8
#: Stroke below that at rest by which the finger counts as moving, and how far apart two strokes on the way are that
#: tell its pace. Chosen: strokes at rest scatter by 0.001.
MOVED, APART = 0.01, 0.03
#: Time of a whole closing at register speed 1 [s], and how long the finger is then watched [s]. Chosen: at speed 25 it
#: meets the surface after 4.5 s; most logs go on for 1 s.
CLOSING_S, WATCHED_S = 120.0, 1.2


def episodes(columns: Columns) -> Iterator[Episode]:
    """Yield one episode a trial: the finger rests, is sent, and closes on the surface.

    `joint_position` and `action` are strokes, 0 closed and 1 open. `fingertip_force` is the motor's estimate, along the
    fingertip's z alone: the surface presses against it. The source's `Middle_Force_N` holds grams and is not read.

    When the hand took its target was not logged: the finger moves 0.05 to 6.7 s after the stage's mark, as the source's
    threads had it. The target is put where the finger starts to move. Trials of one speed last equally long, so that
    they are repeats of one motion: the rest of a longer log is left out, and rows after a shorter one are not valid.
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
    length = round((CLOSING_S / speed + WATCHED_S) * RATE_HZ) if speed else None
    arrays, invalid = _closing(resampled.arrays, length)
    contact_rule = derive_contact(arrays, invalid)
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
            invalid_counts=invalid,
            labels={
                "mode": mode,
                "speed": speed,
                "force_limit_g": limit_g,
                "force_trigger_g": int(trial["Force_Trigger_g"][0]),
                "trial": number,
            },
        ),
        arrays,
    )


def _closing(arrays: Columns, length: int | None) -> tuple[dict[str, NDArray], dict[str, int]]:
    """Return the rows from `REST_ROWS` before the finger starts to move, and how many are not valid by channel.

    There are `length` rows after the start, those beyond the log not valid; all that were logged where it is None.
    """
    marked = int(np.argmax(arrays["action"][:, 0] < TARGET["open"] / STROKE))
    logged = len(arrays["time_ns"])
    seen = {c: arrays.get(c + VALID_SUFFIX, np.ones(logged, bool)) for c in ("joint_position", "fingertip_force")}
    start = _start_row(arrays["joint_position"][:, 0], seen["joint_position"], marked)
    rest = min(REST_ROWS, start)
    end = logged if length is None else start + length
    rows = np.minimum(np.arange(start - rest, end), logged - 1)
    is_logged = np.arange(start - rest, end) < logged
    cut = {"time_ns": np.rint(np.arange(len(rows)) * 1e9 / RATE_HZ).astype(np.int64)}
    cut["action"] = arrays["action"][rows]
    cut["action"][:rest] = TARGET["open"] / STROKE
    cut["action"][rest : rest + max(marked - start, 0)] = arrays["action"][marked]
    invalid = {}
    for channel in seen:
        cut[channel] = arrays[channel][rows]
        valid = is_logged & seen[channel][rows]
        if not valid.all():
            cut[channel + VALID_SUFFIX] = valid
            invalid[channel] = int((~valid).sum())
    return cut, invalid


def _start_row(stroke: NDArray, seen: NDArray[np.bool_], marked: int) -> int:
    """Return the row in which a finger starts to move that is marked as closing from row `marked` on.

    Logs pause while the hand is being commanded, so that the start may lie before the first reading. A line through two
    of the first strokes on the way leads back to it.
    """
    rest = float(np.median(stroke[:marked][seen[:marked]][-REST_ROWS:]))
    rows = marked + np.flatnonzero(seen[marked:])
    fallen = rest - medfilt(stroke[rows], 3)[1:-1]  # a single reading may be off
    rows = rows[1:-1]
    first = int(np.argmax(fallen > MOVED))
    second = int(np.argmax(fallen > fallen[first] + APART))
    pace = (fallen[second] - fallen[first]) / (rows[second] - rows[first])
    return max(int(rows[first] - fallen[first] / pace), 0)


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
