"""550 real tosses of an acrylic cube onto a table (ContactNets; DAIRLab/dair_pll), BSD 3-Clause.

Pfrommer, Halm, Posa, "ContactNets", CoRL 2020 (arXiv 2009.11193); Acosta, Yang, Posa, "Validating Robotics
Simulators on Real-World Impacts", RA-L 2022 (arXiv 2110.00541).
"""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import NDArray

from candata.fetch import PublicDataset
from candata.fetch._toss_archive import RATE_HZ, TossFolder, columns_of
from candata.schema.scene import TableMap

REVISION = "523d372d8c2b50ea5ce77082d4f08879c753d963"
FOLDER = "assets/contactnets_cube"
#: Name git gives that folder at that revision: pins all 550 files and their names.
TREE = "a5d1c583ef1679aed2a376bf0e167c844fd99071"
#: sha256 of the table prepared from the folder.
TABLE_SHA256 = "a34c20600c009fc914e404c856ee1b285e34e491d629683efc4fffc7aba6f53c"

#: What `examples/cube_tosses/map.yaml` says: poses, then world velocities and the spin in the body frame.
MAP = TableMap(
    file="tosses.parquet",
    source="real",
    episode="episode",
    time_s="t",
    rate_hz=RATE_HZ,
    scene="cube_toss",
    object="cube",
    task="toss",
    channels={
        "object_pose": ("px", "py", "pz", "qw", "qx", "qy", "qz"),
        "object_velocity": ("vx", "vy", "vz", "wx", "wy", "wz"),
    },
)

#: Order of the numbers in a frame of the original files: orientation, position, body spin, velocity.
_FRAME = ("qw", "qx", "qy", "qz", "px", "py", "pz", "wx", "wy", "wz", "vx", "vy", "vz")


def toss_columns(tosses: Mapping[str, bytes]) -> dict[str, NDArray]:
    """Return the columns of the original files, one toss a file, in the order of their numbers.

    Raises
    ------
    DataError
        When a file is no torch archive of frames.
    """
    return columns_of(tosses, _FRAME)


TOSSES = TossFolder(REVISION, FOLDER, TREE, TABLE_SHA256, MAP, toss_columns)
SOURCE = PublicDataset(
    name="cube_tosses",
    summary="550 real tosses of an acrylic cube onto a table, 148 Hz",
    origin=TOSSES.origin,
    licence="BSD-3-Clause",
    from_folder=TOSSES.from_folder,
    download=TOSSES.download,
)
