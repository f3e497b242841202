"""Where commands write, tried before they work: what cannot be written is told at once, not after minutes."""

from __future__ import annotations

import errno
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Literal

from candata.errors import CandataError, SetupError, UsageError, Where

#: What is written: a `folder` of files or a `file`, either of which may stand; something `new`, which may not; or a
#: `dataset`, which is new or one that stands.
Kind = Literal["folder", "file", "new", "dataset"]
_NOT_ONE = {"folder": "a folder", "file": "a file"}


def check_output(path: Path, kind: Kind, option: str = "--out", fix: str | None = None) -> None:
    """Refuse an output that cannot be written, or would lie in a dataset; nothing is left of the trial.

    Parameters
    ----------
    path : Path
        What is to be written.
    kind : str
        What it is.
    option : str
        Which option named it, for the message.
    fix : str, optional
        What to do where something new stands already.

    Raises
    ------
    UsageError
        When something stands in its place, it is not of its kind, or it lies in a dataset.
    SetupError
        When the system does not let it be written.
    """
    fix = fix or f"choose another {option}"
    try:
        _refuse_existing(path, kind, option, fix)
        _refuse_in_dataset(path, kind, option)
        _try_writing(path)
    except OSError as error:
        raise SetupError(
            f"{option} {path} cannot be written",
            found=error.strerror or str(error),
            where=Where(path=str(error.filename or path)),
            fix=f"ask for the right to write there, or choose another {option}",
        ) from None


def _refuse_existing(path: Path, kind: Kind, option: str, fix: str) -> None:
    """Refuse what stands in the output's place."""
    place = Where(path=str(path))
    if kind == "new" and (path.exists() or path.is_symlink()):
        raise UsageError("the output exists already", where=place, fix=fix)
    if path.is_symlink() and not path.exists():
        raise UsageError(f"{option} {path} is a link that leads nowhere", where=place, fix=fix)
    if kind == "dataset":
        from candata.datasets.versions import refuse_foreign

        refuse_foreign(path)
    elif kind in _NOT_ONE and path.exists() and not (path.is_dir() if kind == "folder" else path.is_file()):
        kind_found = "a folder" if path.is_dir() else "a file" if path.is_file() else "a device"
        name = f"name another {kind}"
        raise UsageError(f"{option} {path} is {kind_found}", expected=_NOT_ONE[kind], found=kind_found, fix=name)


def _refuse_in_dataset(path: Path, kind: Kind, option: str) -> None:
    """Refuse a place in a dataset: what is not of it would be taken for leftovers, and confuse who reads it."""
    place = path.resolve()
    for folder in place.parents if kind == "dataset" else (place, *place.parents):
        if _is_dataset(folder):
            raise UsageError(
                f"{option} {path} lies in a dataset",
                expected="a place outside of it: a dataset holds nothing but its own files",
                found=f"the dataset {folder}",
                fix=f"choose another {option}",
            )


def _is_dataset(folder: Path) -> bool:
    """Tell whether a folder is a dataset of candata."""
    from candata.datasets.versions import format_of

    with suppress(CandataError):
        return format_of(folder) > 0
    return False


def _try_writing(path: Path) -> None:
    """Raise OSError where the nearest folder that stands takes no file, or no such names."""
    base = next(folder for folder in path.absolute().parents if folder.exists())
    base = path if path.is_dir() else base
    if not base.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(base))
    for name in path.absolute().relative_to(base.absolute()).parts:
        with suppress(FileNotFoundError):
            os.lstat(base / name)  # a name that is too long is refused here
    with tempfile.TemporaryFile(dir=base):
        pass
