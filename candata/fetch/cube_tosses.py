"""550 real tosses of an acrylic cube onto a table (ContactNets; DAIRLab/dair_pll), BSD 3-Clause.

Pfrommer, Halm, Posa, "ContactNets", CoRL 2020 (arXiv 2009.11193); Acosta, Yang, Posa, "Validating Robotics
Simulators on Real-World Impacts", RA-L 2022 (arXiv 2110.00541).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from numpy.typing import NDArray

from candata.fetch import FetchedEpisodes, PublicDataset
from candata.fetch._files import require_sha256
from candata.fetch._toss_archive import LICENCE_SHA256, RATE_HZ, archive_of, checked_tosses, columns_of
from candata.formats.table import episodes, map_digest, read_mapped
from candata.schema.scene import TableMap

REVISION = "523d372d8c2b50ea5ce77082d4f08879c753d963"
ARCHIVE = f"https://codeload.github.com/DAIRLab/dair_pll/tar.gz/{REVISION}"
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


def from_folder(folder: Path) -> FetchedEpisodes:
    """Return the tosses in a prepared folder: `tosses.parquet` and `LICENSE.txt`, hashes checked.

    Raises
    ------
    DataError
        When a file is missing or is not the published one.
    """
    licence, table = Path(folder) / "LICENSE.txt", Path(folder) / MAP.file
    require_sha256(licence, LICENCE_SHA256, f"put the LICENSE of {SOURCE.origin} beside the data")
    require_sha256(table, TABLE_SHA256, "get the folder again, or download: leave out --from")
    notice = licence.read_text(encoding="utf-8")
    return FetchedEpisodes(read_mapped(MAP, table), map_digest(MAP, TREE), notice)


def from_archive(archive: Path, tree: str = TREE, licence_sha256: str = LICENCE_SHA256) -> FetchedEpisodes:
    """Return the tosses in an archive of the repository, checked against git's hash of the folder.

    Raises
    ------
    DataError
        When the archive is damaged, lacks the licence, or holds other data.
    """
    tosses, notice = checked_tosses(archive, FOLDER, tree, licence_sha256)
    return FetchedEpisodes(episodes(MAP, toss_columns(tosses), Path(MAP.file)), map_digest(MAP, tree), notice)


def fetch(cache: Path, say: Callable[[str], None], url: str = ARCHIVE) -> FetchedEpisodes:
    """Return the tosses from their public repository; an archive that is in the cache is not asked for again.

    Raises
    ------
    SetupError
        When the repository cannot be reached.
    DataError
        When what came is not the published data.
    """
    return from_archive(archive_of(cache, REVISION, say, url))


def toss_columns(tosses: Mapping[str, bytes]) -> dict[str, NDArray]:
    """Return the columns of the original files, one toss a file, in the order of their numbers.

    Raises
    ------
    DataError
        When a file is no torch archive of frames.
    """
    return columns_of(tosses, _FRAME)


SOURCE = PublicDataset(
    name="cube_tosses",
    summary="550 real tosses of an acrylic cube onto a table, 148 Hz",
    origin=f"github.com/DAIRLab/dair_pll, {FOLDER} at {REVISION[:8]}",
    licence="BSD-3-Clause",
    from_folder=from_folder,
    download=fetch,
)
