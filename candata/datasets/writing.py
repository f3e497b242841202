"""Single files: whole or not at all, and an error that a user can act on where they cannot be written."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from candata.datasets.drafts import draft_beside
from candata.errors import SetupError, Where


@contextmanager
def replacing(path: Path, what: str = "page") -> Iterator[Path]:
    """Give a draft beside `path`, which takes its place at the end; folders on the way are made.

    Several processes may write the same file at once: the last one's stands, whole.

    Raises
    ------
    SetupError
        When `what` cannot be written.
    """
    try:
        with draft_beside(path) as folder:
            yield folder / path.name
            os.replace(folder / path.name, path)
    except OSError as error:
        raise SetupError(
            f"the {what} cannot be written",
            found=error.strerror or str(error),
            where=Where(path=str(path)),
            fix="free space, or name another place",
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
