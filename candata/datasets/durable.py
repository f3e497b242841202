"""Files that are either whole or absent: staging, fsync, exclusive create, hashes."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from candata.errors import DataError, SetupError, UsageError, Where
from candata.lfs import pointer_error
from candata.schema.json_text import MOST_BYTES, parse_json
from candata.schema.record import Record
from candata.schema.text_bounds import TextError, read_bounded

STAGING_FOLDER = "staging"
#: Folder in it in which a pull keeps whole files until their part is whole.
PULL_FOLDER = "pull"

#: How long a thread that still writes after a failure is waited for, in s, before each further removal.
LATE_S = (0.05, 0.25)

#: What file systems without hard links answer.
NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EMLINK, errno.ENOSYS)

SomeRecord = TypeVar("SomeRecord", bound=Record)


def sync(path: Path) -> None:
    """Force a file's bytes, or a folder's entries, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_tree(folder: Path) -> None:
    """Force a folder and all in it to the disk."""
    for path in [*folder.rglob("*"), folder]:
        sync(path)


def ensure_folder(path: Path) -> Path:
    """Return `path` as an existing folder whose entry in its parent is on the disk."""
    if not path.is_dir():
        path.mkdir(parents=True, exist_ok=True)
        sync(path.parent)
    return path


def ensure_below(root: Path, path: Path) -> Path:
    """Return `path` as an existing folder in `root` or deeper; a root that was moved away is not made anew.

    Raises
    ------
    SetupError
        When there is no `root`.
    """
    relative = path.relative_to(root)
    if not root.is_dir():
        raise moved_away_error(root)
    for folder in (root / part for part in [*list(relative.parents)[-2::-1], relative] if part != Path()):
        if not folder.is_dir():
            try:
                folder.mkdir(exist_ok=True)
            except FileNotFoundError:
                raise moved_away_error(root) from None
            sync(folder.parent)
    return path


def moved_away_error(root: Path) -> SetupError:
    """Return the error for a dataset that was moved away while it was written to."""
    return SetupError(
        "the folder of the dataset has gone",
        where=Where(path=str(root)),
        fix="bring it back and run this again: what was published stands, and what was stopped goes on",
    )


def touch(path: Path) -> None:
    """Set the time stamp of a file or folder to now, so that gc leaves it alone; those of other users stay.

    Raises
    ------
    FileNotFoundError
        When it does not stand.
    """
    with suppress(PermissionError):
        os.utime(path)


@contextmanager
def staging_folder(root: Path) -> Iterator[Path]:
    """Give a fresh folder under `root/staging`; whatever is left in it at the end is removed.

    Raises
    ------
    SetupError
        When there is no `root`, or the block failed because root or folder were taken away.
    """
    folder = ensure_below(root, root / STAGING_FOLDER) / uuid.uuid4().hex
    folder.mkdir()
    with temporary_folder(folder):
        try:
            yield folder
        except OSError:
            if not root.is_dir():
                raise moved_away_error(root) from None
            if not folder.is_dir():
                raise SetupError(
                    "what was being written was collected as garbage",
                    where=Where(path=str(root)),
                    fix="run this again; give candata gc a --grace longer than any job takes",
                ) from None
            raise


def replace_synced(draft: Path, path: Path) -> None:
    """Let a finished draft take the place of `path`; after a power loss the old file stands, or the new one, whole."""
    sync(draft)
    os.replace(draft, path)
    sync(path.parent)


@contextmanager
def replacing_staged(root: Path, path: Path) -> Iterator[Path]:
    """Give a draft in the staging folder of the dataset `root`, which takes the place of `path` at the end.

    Its folder is made when missing. What a killed process left goes with the garbage of the dataset.

    Raises
    ------
    SetupError
        When there is no `root`.
    """
    ensure_below(root, path.parent)
    with staging_folder(root) as folder:
        draft = folder / path.name
        yield draft
        replace_synced(draft, path)


@contextmanager
def temporary_folder(folder: Path) -> Iterator[None]:
    """Remove a folder at the end of the block, and after a failure also what other threads still put there.

    zarr writes in threads and waits for none of them when one fails; the last may make the folder anew.
    """
    try:
        yield
    except BaseException:
        for pause_s in LATE_S:
            shutil.rmtree(folder, ignore_errors=True)
            time.sleep(pause_s)
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def exclusive_lock(folder: Path, busy: str | None = None) -> Iterator[None]:
    """Wait until no other process is in this block for the same folder; where folders cannot be locked, go on.

    Parameters
    ----------
    folder : Path
        Existing folder.
    busy : str, optional
        What the other process does: then nothing is waited for.

    Raises
    ------
    UsageError
        When `busy` is given and another process is in the block.
    """
    with _folder_lock(folder, fcntl.LOCK_EX | (fcntl.LOCK_NB if busy else 0), busy):
        yield


@contextmanager
def _folder_lock(folder: Path, operation: int, busy: str | None = None) -> Iterator[None]:
    """Hold a lock of the system on a folder, which releases it even when the process is killed."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(handle, operation)
        except BlockingIOError:
            raise UsageError(
                str(busy), where=Where(path=str(folder)), fix="wait until it has ended, or choose another --out"
            ) from None
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(handle)


@contextmanager
def publish_lock(root: Path) -> Iterator[None]:
    """Hold a shared lock while something is published: garbage is removed before or after, not meanwhile."""
    with _folder_lock(ensure_below(root, root / STAGING_FOLDER), fcntl.LOCK_SH):
        yield


@contextmanager
def removal_lock(root: Path) -> Iterator[None]:
    """Hold an exclusive lock while garbage is removed: nothing is published meanwhile."""
    with _folder_lock(ensure_below(root, root / STAGING_FOLDER), fcntl.LOCK_EX):
        yield


@contextmanager
def writing(root: Path) -> Iterator[None]:
    """Turn what the system says against writing below `root` into an error that a user can act on.

    Raises
    ------
    SetupError
        When the folder cannot be written, or the disk is full.
    """
    try:
        yield
    except OSError as error:
        raise SetupError(
            "the dataset cannot be written",
            found=reason(error),
            where=Where(path=str(error.filename or root)),
            fix="free space, or ask for the right to write; candata doctor FOLDER looks for the cause",
        ) from None


def create_once(root: Path, target: Path, data: bytes) -> bool:
    """Write `target` whole unless it exists; return whether this call made it.

    The bytes are staged and synced first, then hard-linked to the name, which fails when it is taken.

    Raises
    ------
    SetupError
        When the file system has no hard links, or there is no `root`.
    """
    ensure_below(root, target.parent)
    with staging_folder(root) as folder:
        draft = folder / target.name
        draft.write_bytes(data)
        sync(draft)
        try:
            os.link(draft, target)
        except FileExistsError:
            return False
        except OSError as error:
            if error.errno not in NO_HARD_LINKS:
                raise
            raise SetupError(
                "the file system cannot make hard links, which publishing a version needs",
                found=error.strerror,
                where=Where(path=str(target.parent)),
                fix="keep the dataset on a local disk; candata doctor FOLDER tells what a folder can do",
            ) from None
        sync(target.parent)
    return True


def file_sha256(path: Path) -> str:
    """Return the sha256 of a file's bytes as hex.

    Raises
    ------
    OSError
        When the file cannot be read.
    """
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def encode_record(record: Record) -> bytes:
    """Return the record as indented JSON, keys in the order of the fields."""
    return (record.model_dump_json(indent=1) + "\n").encode()


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a JSON file of the dataset.

    Raises
    ------
    DataError
        When the file is missing, too large, or cannot be read; names it.
    """
    try:
        return read_bounded(path, MOST_BYTES)
    except (OSError, TextError) as error:
        raise damaged_error(path, reason(error)) from None


def read_record(kind: type[SomeRecord], path: Path, data: bytes | None = None) -> SomeRecord:
    """Return the record kept in the JSON file `path` (or in `data`, its bytes).

    Raises
    ------
    DataError
        When the file is missing or does not hold such a record; names it.
    """
    raw = read_bytes(path) if data is None else data
    try:
        return decode_record(kind, raw, path)
    except ValueError as error:
        raise damaged_error(path, f"no valid JSON: {error}") from None
    except UsageError as error:
        raise damaged_error(path, error.problem) from None


def decode_record(kind: type[SomeRecord], data: bytes, path: str | Path) -> SomeRecord:
    """Return the record in JSON bytes that came from `path`.

    Raises
    ------
    ValueError
        When they are no JSON, or hold text that no file can.
    UsageError
        When they hold no such record; names the field.
    """
    return kind.parse(parse_json(data), path)


def damaged_error(path: Path, found: str, expected: str = "the file as it was written") -> DataError:
    """Return the error for a file of the dataset that is missing or no longer what was written."""
    return pointer_error(path) or DataError(
        f"damaged dataset: {path.name}",
        expected=expected,
        found=found,
        where=Where(path=str(path)),
        fix="restore the file from a copy; candata validate lists everything that is damaged",
    )


def reason(error: Exception) -> str:
    """Return why reading failed, in one line."""
    if isinstance(error, FileNotFoundError):
        return "no such file"
    text = getattr(error, "strerror", None) or str(error)
    return (text.splitlines() or [type(error).__name__])[0]
