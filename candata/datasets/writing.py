"""Single files: whole or not at all, and an error that a user can act on where they cannot be written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from candata.datasets import durable
from candata.datasets.drafts import draft_beside
from candata.errors import SetupError, Where

#: What to do where a file cannot be written.
FIX = "free space, or name another place"
#: Rights to read and to write, for the owner, the group and others.
_READ_WRITE = 0o666


@contextmanager
def replacing(path: Path, what: str = "page", fix: str = FIX, parents: bool = True) -> Iterator[Path]:
    """Give a draft beside `path`, which takes its place at the end.

    Several processes may write the same file at once: the last one's stands, whole. The file has the rights that the
    process gives to new files, whatever the writer of the draft gave it. Nothing is left after a failure or Ctrl-C.

    Parameters
    ----------
    path : Path
        File to write.
    what : str
        What it is, for the error.
    fix : str
        What to do where it cannot be written, for the error.
    parents : bool
        Whether the folders on the way are made when missing.

    Raises
    ------
    SetupError
        When `what` cannot be written.
    """
    with refused(path, what, fix), draft_beside(path, parents) as folder:
        draft = folder / path.name
        yield draft
        draft.chmod(folder.stat().st_mode & _READ_WRITE)
        durable.replace_synced(draft, path)


@contextmanager
def refused(path: Path, what: str, fix: str = FIX) -> Iterator[None]:
    """Turn what the system says against writing `path` into an error that a user can act on.

    Raises
    ------
    SetupError
        When the block fails with an OSError.
    """
    try:
        yield
    except OSError as error:
        raise SetupError(
            f"the {what} cannot be written",
            found=error.strerror or str(error),
            where=Where(path=str(path)),
            fix=fix,
        ) from None


def write_text(path: Path, text: str, what: str = "page") -> Path:
    """Return `path` after writing a text there.

    Raises
    ------
    SetupError
        When it cannot be written.
    """
    with replacing(path, what) as draft:
        draft.write_text(text, encoding="utf-8")
    return path
