"""541 real tosses of two links on a free hinge onto a table (ContactNets elbow; DAIRLab/dair_pll), BSD 3-Clause.

Bianchini, Halm, Posa, "Simultaneous Learning of Contact and Continuous Dynamics", 2023 (arXiv 2310.12054).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from candata.fetch import PublicDataset
from candata.fetch._toss_archive import RATE_HZ, TossFolder, columns_of
from candata.schema.scene import TableMap

REVISION = "b5d0a2f9cc4cb8f5867ae6c4141d6c9e860f1c6f"
FOLDER = "assets/contactnets_elbow"
#: Name git gives that folder at that revision: pins all 541 files and their names.
TREE = "7930bb96baa6adde3f56f4a55f5672495b11617e"
#: sha256 of the table prepared from the folder.
TABLE_SHA256 = "87428f9adc8b5d9b9e7fbefcae2c26e330adce3cca4447884fe8c6d66b288f39"

#: What `examples/elbow_tosses/map.yaml` says: pose of link 1, the hinge, their velocities.
MAP = TableMap(
    file="elbow_tosses.parquet",
    source="real",
    episode="episode",
    time_s="t",
    rate_hz=RATE_HZ,
    scene="elbow_toss",
    object="elbow",
    task="toss",
    channels={
        "object_pose": ("px", "py", "pz", "qw", "qx", "qy", "qz"),
        "object_velocity": ("vx", "vy", "vz", "wx", "wy", "wz"),
        "joint_position": ("hinge",),
    },
)

#: Order of the numbers in a frame of the original files.
_FRAME = ("qw", "qx", "qy", "qz", "px", "py", "pz", "hinge", "wx", "wy", "wz", "vx", "vy", "vz", "hinge_rate")


def toss_columns(tosses: Mapping[str, bytes]) -> dict[str, NDArray]:
    """Return the columns of the original files; the hinge, stored within half a turn, goes on past it.

    Raises
    ------
    DataError
        When a file is no torch archive of frames.
    """
    columns = columns_of(tosses, _FRAME)
    for number in np.unique(columns["episode"]):
        in_toss = columns["episode"] == number
        columns["hinge"][in_toss] = np.unwrap(columns["hinge"][in_toss])
        turns = np.stack([columns[q][in_toss] for q in _FRAME[:4]], axis=1)
        sign = np.cumprod(np.where((turns[1:] * turns[:-1]).sum(1) < 0, -1, 1))
        for k, q in enumerate(_FRAME[:4]):
            columns[q][in_toss] = turns[:, k] * np.concatenate([[1], sign])
    return columns


TOSSES = TossFolder(REVISION, FOLDER, TREE, TABLE_SHA256, MAP, toss_columns)
SOURCE = PublicDataset(
    name="elbow_tosses",
    summary="541 real tosses of two hinged links onto a table, 148 Hz",
    origin=TOSSES.origin,
    licence="BSD-3-Clause",
    from_folder=TOSSES.from_folder,
    download=TOSSES.download,
)
