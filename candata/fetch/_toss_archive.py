"""Tosses in an archive of DAIRLab/dair_pll: a folder of torch files, one toss each, and the licence beside it."""

from __future__ import annotations

import hashlib
import io
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.fetch import FetchedEpisodes
from candata.fetch._files import download, git_tree_hash, require_sha256
from candata.formats.table import episodes, map_digest, read_mapped
from candata.schema.scene import TableMap

#: sha256 of the repository's licence file.
LICENCE_SHA256 = "ed2d040c164ceff95257da3b9c4e2a7134c93310488947871b95e8ac90f91b52"
RATE_HZ = 148.0


@dataclass(frozen=True)
class TossFolder:
    """A folder of tosses in the repository, as its originals and as a table that was prepared from them.

    Attributes
    ----------
    revision, folder : str
        Of the repository, and the folder at that revision.
    tree : str
        Name git gives the folder: pins all its files and their names.
    table_sha256 : str
        Of the prepared table.
    mapping : TableMap
        What the table's columns are.
    columns : callable
        Returns the table's columns from the original files.
    """

    revision: str
    folder: str
    tree: str
    table_sha256: str
    mapping: TableMap
    columns: Callable[[Mapping[str, bytes]], dict[str, NDArray]]

    @property
    def origin(self) -> str:
        """Where it is published, with the revision."""
        return f"github.com/DAIRLab/dair_pll, {self.folder} at {self.revision[:8]}"

    def from_folder(self, folder: Path) -> FetchedEpisodes:
        """Return the tosses in a prepared folder: the table and `LICENSE.txt`, hashes checked.

        Raises
        ------
        DataError
            When a file is missing or is not the published one.
        """
        licence, table = Path(folder) / "LICENSE.txt", Path(folder) / self.mapping.file
        require_sha256(licence, LICENCE_SHA256, f"put the LICENSE of {self.origin} beside the data")
        require_sha256(table, self.table_sha256, "get the folder again, or download: leave out --from")
        notice = licence.read_text(encoding="utf-8")
        return FetchedEpisodes(read_mapped(self.mapping, table), map_digest(self.mapping, self.tree), notice)

    def from_archive(
        self, archive: Path, tree: str | None = None, licence_sha256: str = LICENCE_SHA256
    ) -> FetchedEpisodes:
        """Return the tosses in an archive of the repository, checked against git's hash of the folder.

        Raises
        ------
        DataError
            When the archive is damaged, lacks the licence, or holds other data.
        """
        tree = tree or self.tree
        tosses, notice = checked_tosses(archive, self.folder, tree, licence_sha256)
        tossed = episodes(self.mapping, self.columns(tosses), Path(self.mapping.file))
        return FetchedEpisodes(tossed, map_digest(self.mapping, tree), notice)

    def download(self, cache: Path, say: Callable[[str], None]) -> FetchedEpisodes:
        """Return the tosses from their public repository; an archive that is in the cache is not asked for again.

        Raises
        ------
        SetupError
            When the repository cannot be reached.
        DataError
            When what came is not the published data.
        """
        return self.from_archive(archive_of(cache, self.revision, say))


def checked_tosses(archive: Path, folder: str, tree: str, licence_sha256: str) -> tuple[dict[str, bytes], str]:
    """Return the files of a folder of the archive, by toss, and the licence's text; both checked.

    Raises
    ------
    DataError
        When the archive is damaged, lacks the licence, or holds other data.
    """
    location = Where(path=str(archive))
    tosses, licence = _members(archive, folder)
    tree_hash = git_tree_hash(tosses)
    if tree_hash != tree:
        raise DataError(
            f"{folder} is not the published folder",
            expected=f"git tree {tree}",
            found=f"git tree {tree_hash}, {len(tosses)} files",
            where=location,
            fix="delete the file and fetch again",
        )
    if hashlib.sha256(licence).hexdigest() != licence_sha256:
        raise DataError("the licence file is missing or another one", expected="LICENSE", where=location)
    return {name.removesuffix(".pt"): content for name, content in tosses.items()}, licence.decode()


def archive_of(cache: Path, revision: str, say: Callable[[str], None]) -> Path:
    """Return the archive of a revision; one that is in the cache is not asked for again.

    Raises
    ------
    SetupError
        When the repository cannot be reached.
    """
    archive = Path(cache) / f"dair_pll-{revision[:12]}.tar.gz"
    if archive.is_file():
        say(f"using {archive}")
    else:
        download(f"https://codeload.github.com/DAIRLab/dair_pll/tar.gz/{revision}", archive, say)
    return archive


def columns_of(tosses: Mapping[str, bytes], names: Sequence[str]) -> dict[str, NDArray]:
    """Return the columns of the original files, one toss a file, in the order of their numbers.

    A file is a torch archive of one contiguous `(T, C) float64` tensor whose first four numbers are the orientation;
    its bytes are read as they are, so neither torch nor a pickle is needed. Orientations start with w >= 0 and keep
    the recorded continuity.

    Raises
    ------
    DataError
        When a file is no such archive.
    """
    frames = [(int(name), _frames(name, tosses[name], len(names))) for name in sorted(tosses, key=int)]
    columns = {name: np.concatenate([f[:, k] for _, f in frames]) for k, name in enumerate(names)}
    columns["episode"] = np.concatenate([np.full(len(f), number) for number, f in frames])
    columns["t"] = np.concatenate([np.arange(len(f)) / RATE_HZ for _, f in frames])
    return columns


def _frames(name: str, content: bytes, width: int) -> NDArray[np.float64]:
    """Return `(T, C) float64`: the frames of one toss."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            frames = np.frombuffer(archive.read("archive/data/0"), "<f8").reshape(-1, width).copy()
    except (zipfile.BadZipFile, KeyError, ValueError, zlib.error) as error:
        raise DataError("a toss cannot be read", found=str(error), where=Where(episode=name)) from None
    if frames[0, 0] < 0:
        frames[:, :4] *= -1
    return frames


def _members(archive: Path, folder: str) -> tuple[dict[str, bytes], bytes]:
    """Return the files of the data folder and the licence; nothing is unpacked to the disk."""
    tosses, licence = {}, b""
    try:
        with tarfile.open(archive, "r:gz") as tar:
            for member in tar:
                path = member.name.partition("/")[2]
                if member.isfile() and path.rpartition("/")[0] == folder:
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
