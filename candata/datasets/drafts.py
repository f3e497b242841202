"""New folders, made beside the place they take: whole or absent; what killed processes left goes with the next one."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from candata.datasets import durable
from candata.errors import UsageError, Where

_DRAFT = re.compile(r"\..+\.candata-[0-9a-f]{32}", re.DOTALL)


def is_draft(name: str) -> bool:
    """Return whether a folder of this name is a draft, which goes with the next one beside it."""
    return _DRAFT.fullmatch(name) is not None


@contextmanager
def draft_beside(out: Path, parents: bool = True) -> Iterator[Path]:
    """Give an empty hidden folder beside `out`, which goes at the end; those that killed processes left there go first.

    The system releases the lock on a draft when its process ends, however it ends. Where folders cannot be locked,
    nobody's draft is taken away.

    Parameters
    ----------
    out : Path
        What is to be made.
    parents : bool
        Whether its parents are made when missing.
    """
    if parents:
        out.parent.mkdir(parents=True, exist_ok=True)
    _sweep(out.parent)
    folder, lock = _locked_draft(out)
    try:
        with durable.temporary_folder(folder):
            yield folder
    finally:
        if lock is not None:
            os.close(lock)


def place(draft: Path, out: Path) -> None:
    """Give a finished draft its name.

    Raises
    ------
    UsageError
        When another process took the name meanwhile.
    """
    refuse_standing(out)
    try:
        os.rename(draft, out)
    except OSError:
        refuse_standing(out)
        raise
    durable.sync(out.parent)


def refuse_standing(out: Path) -> None:
    """Refuse an output that stands.

    Raises
    ------
    UsageError
        When it does.
    """
    if out.exists() or out.is_symlink():
        raise UsageError("the output exists already", where=Where(path=str(out)), fix="choose another --out")


def _locked_draft(out: Path) -> tuple[Path, int | None]:
    """Return a new draft and its lock, None where folders cannot be locked."""
    while True:
        folder = out.parent / f".{out.name}.candata-{uuid.uuid4().hex}"
        folder.mkdir()
        try:
            lock = _lock(folder)
        except (BlockingIOError, FileNotFoundError):
            continue  # another process took it for left before it was locked, and is removing it
        except OSError:
            return folder, None
        if folder.is_dir():
            return folder, lock
        os.close(lock)


def _sweep(parent: Path) -> None:
    """Remove the drafts that no process holds."""
    with suppress(OSError):
        for path in [path for path in parent.iterdir() if is_draft(path.name)]:
            with suppress(OSError):
                lock = _lock(path)
                shutil.rmtree(path, ignore_errors=True)
                os.close(lock)


def _lock(folder: Path) -> int:
    """Return an open handle that locks a folder; raises OSError where another process holds it, or it is none."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle
