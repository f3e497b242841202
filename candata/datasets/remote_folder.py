"""A shared folder as a remote."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from candata.datasets import durable
from candata.datasets.gc import collect_staging
from candata.datasets.store import CHUNK_BYTES
from candata.errors import SetupError, Where


class FolderStore:
    """A folder that stands; links in it are not followed."""

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            raise SetupError(
                "the folder of the remote is not there", where=Where(path=str(root)), fix="mount the share, or make it"
            )
        self._root = root
        self._identity = _identity(root)

    @property
    def url(self) -> str:
        """Address of the remote."""
        return str(self._root)

    def folders(self) -> list[str]:
        """Return the names of the folders in it, sorted."""
        return sorted(entry.name for entry in os.scandir(self._root) if entry.is_dir())

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the files in a folder by name, with their size in bytes."""
        self._require_there(prefix)
        try:
            with os.scandir(self._root / prefix) as entries:
                return {e.name: e.stat().st_size for e in entries if e.is_file(follow_symlinks=False)}
        except (FileNotFoundError, NotADirectoryError):
            return {}
        except OSError as error:
            raise self._failure(error, prefix) from None

    def read(self, key: str) -> Iterator[bytes]:
        """Yield the bytes of a file; raises FileNotFoundError where there is none."""
        try:
            # A pipe or a link under an object's name would stall the reader, or lead it elsewhere.
            handle = os.open(self._root / key, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        except (FileNotFoundError, NotADirectoryError):
            self._require_there(key)
            raise FileNotFoundError(key) from None
        except OSError as error:
            raise self._failure(error, key) from None
        try:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise FileNotFoundError(key)
            while chunk := self._chunk(handle, key):
                yield chunk
        finally:
            os.close(handle)

    def _chunk(self, handle: int, key: str) -> bytes:
        """Return the next bytes of a file."""
        try:
            return os.read(handle, CHUNK_BYTES)
        except OSError as error:
            raise self._failure(error, key) from None

    def write(self, key: str, chunks: Iterable[bytes], size: int) -> None:
        """Keep a file, whole or not at all; one that stands is replaced."""
        target = self._root / key
        self._require_there(key)
        try:
            durable.ensure_folder(target.parent)
            with durable.replacing_staged(self._dataset(key), target) as draft, draft.open("wb") as file:
                for chunk in chunks:
                    file.write(chunk)
        except OSError as error:
            raise self._failure(error, key) from None
        self._require_there(key)

    def create(self, key: str, data: bytes) -> bool:
        """Keep a file unless one stands; return whether this call made it."""
        self._require_there(key)
        try:
            durable.ensure_folder((self._root / key).parent)
            is_created = durable.create_once(self._dataset(key), self._root / key, data)
        except OSError as error:
            raise self._failure(error, key) from None
        self._require_there(key)
        return is_created

    def tidy(self, name: str) -> None:
        """Remove what killed pushes of the dataset `name` left, once it is a week old."""
        try:
            collect_staging(self._root / name)
        except OSError as error:
            raise self._failure(error, name) from None

    def _dataset(self, key: str) -> Path:
        """Return the folder that holds everything of the key's dataset, and what is being written."""
        return self._root / key.split("/", 1)[0]

    def _require_there(self, key: str) -> None:
        """Refuse to go on once the folder has gone: what stands in its place then is a mount point, on another disk."""
        if _identity(self._root) != self._identity:
            raise SetupError(
                "the folder of the remote has gone",
                where=Where(path=f"{self.url}/{key}"),
                fix="mount the share again, then run this again: what was moved so far counts",
            )

    def _failure(self, error: OSError, key: str) -> SetupError:
        """Return the error for a folder that cannot be used."""
        return SetupError(
            "the folder of the remote cannot be used",
            found=durable.reason(error),
            where=Where(path=f"{self.url}/{key}"),
            fix="check that it is mounted and may be written",
        )


def _identity(folder: Path) -> tuple[int, int] | None:
    """Return what tells a folder from another one that takes its name, None where there is none."""
    try:
        state = folder.stat()
    except OSError:
        return None
    return state.st_dev, state.st_ino
