"""550 real tosses of an acrylic cube onto a table (ContactNets; DAIRLab/dair_pll), BSD 3-Clause.

Pfrommer, Halm, Posa, "ContactNets", CoRL 2020 (arXiv 2009.11193); Acosta, Yang, Posa, "Validating Robotics
Simulators on Real-World Impacts", RA-L 2022 (arXiv 2110.00541).
"""

from __future__ import annotations

import hashlib
import io
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.fetch import Fetched, Source
from candata.fetch._files import download, git_tree_hash, require_sha256
from candata.formats.table import episodes, map_digest, read_mapped
from candata.schema.scene import TableMap

REVISION = "523d372d8c2b50ea5ce77082d4f08879c753d963"
ARCHIVE = f"https://codeload.github.com/DAIRLab/dair_pll/tar.gz/{REVISION}"
FOLDER = "assets/contactnets_cube"
#: Name git gives that folder at that revision: pins all 550 files and their names.
TREE = "a5d1c583ef1679aed2a376bf0e167c844fd99071"
#: sha256 of the repository's licence file, and of the table prepared from the folder.
LICENCE_SHA256 = "ed2d040c164ceff95257da3b9c4e2a7134c93310488947871b95e8ac90f91b52"
TABLE_SHA256 = "a34c20600c009fc914e404c856ee1b285e34e491d629683efc4fffc7aba6f53c"
RATE_HZ = 148.0

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


def from_folder(folder: Path) -> Fetched:
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
    return Fetched(read_mapped(MAP, table), map_digest(MAP, TREE), notice)


def from_archive(archive: Path, tree: str = TREE, licence_sha256: str = LICENCE_SHA256) -> Fetched:
    """Return the tosses in an archive of the repository, checked against git's hash of the folder.

    Raises
    ------
    DataError
        When the archive is damaged, lacks the licence, or holds other data.
    """
    where = Where(path=str(archive))
    tosses, licence = _members(archive)
    found = git_tree_hash(tosses)
    if found != tree:
        raise DataError(
            f"{FOLDER} is not the published folder",
            expected=f"git tree {tree}",
            found=f"git tree {found}, {len(tosses)} files",
            where=where,
            fix="delete the file and fetch again",
        )
    if hashlib.sha256(licence).hexdigest() != licence_sha256:
        raise DataError("the licence file is missing or another one", expected="LICENSE", where=where)
    columns = toss_columns({name.removesuffix(".pt"): content for name, content in tosses.items()})
    return Fetched(episodes(MAP, columns, Path(MAP.file)), map_digest(MAP, tree), licence.decode())


def fetch(cache: Path, say: Callable[[str], None], url: str = ARCHIVE) -> Fetched:
    """Return the tosses from their public repository; an archive that is in the cache is not asked for again.

    Raises
    ------
    SetupError
        When the repository cannot be reached.
    DataError
        When what came is not the published data.
    """
    archive = Path(cache) / f"dair_pll-{REVISION[:12]}.tar.gz"
    if archive.is_file():
        say(f"using {archive}")
    else:
        download(url, archive, say)
    return from_archive(archive)


def toss_columns(tosses: Mapping[str, bytes]) -> dict[str, NDArray]:
    """Return the columns of the original files, one toss a file, in the order of their numbers.

    A file is a torch archive of one contiguous `(T, 13) float64` tensor; its bytes are read as they are, so
    neither torch nor a pickle is needed. Orientations start with w >= 0 and keep the recorded continuity.

    Raises
    ------
    DataError
        When a file is no such archive.
    """
    frames = [(int(name), _frames(name, tosses[name])) for name in sorted(tosses, key=int)]
    columns = {name: np.concatenate([f[:, k] for _, f in frames]) for k, name in enumerate(_FRAME)}
    columns["episode"] = np.concatenate([np.full(len(f), number) for number, f in frames])
    columns["t"] = np.concatenate([np.arange(len(f)) / RATE_HZ for _, f in frames])
    return columns


def _frames(name: str, content: bytes) -> NDArray[np.float64]:
    """Return `(T, 13) float64`: the frames of one toss."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            frames = np.frombuffer(archive.read("archive/data/0"), "<f8").reshape(-1, len(_FRAME)).copy()
    except (zipfile.BadZipFile, KeyError, ValueError, zlib.error) as error:
        raise DataError("a toss cannot be read", found=str(error), where=Where(episode=name)) from None
    if frames[0, 0] < 0:
        frames[:, :4] *= -1
    return frames


def _members(archive: Path) -> tuple[dict[str, bytes], bytes]:
    """Return the files of the data folder and the licence; nothing is unpacked to the disk."""
    tosses, licence = {}, b""
    try:
        with tarfile.open(archive, "r:gz") as tar:
            for member in tar:
                path = member.name.partition("/")[2]
                if member.isfile() and path.rpartition("/")[0] == FOLDER:
                    tosses[path.rpartition("/")[2]] = tar.extractfile(member).read()  # type: ignore[union-attr]
                elif member.isfile() and path == "LICENSE":
                    licence = tar.extractfile(member).read()  # type: ignore[union-attr]
    except (tarfile.TarError, EOFError, OSError, zlib.error) as error:
        raise DataError(
            "the archive cannot be read",
            found=str(error),
            where=Where(path=str(archive)),
            fix="delete the file and fetch again",
        ) from None
    return tosses, licence


SOURCE = Source(
    name="cube_tosses",
    summary="550 real tosses of an acrylic cube onto a table, 148 Hz",
    origin=f"github.com/DAIRLab/dair_pll, {FOLDER} at {REVISION[:8]}",
    licence="BSD-3-Clause",
    from_folder=from_folder,
    download=fetch,
)
