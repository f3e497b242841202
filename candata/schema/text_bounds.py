"""Text that a user or a stranger wrote: UTF-8 of a bounded size, and the one error of whatever is wrong with it."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from candata.errors import UsageError, Where
from candata.lfs import refuse_pointer

#: Digits of a number in YAML: the largest double has 309 before the point; Python converts no more than 4,300. Chosen.
MOST_DIGITS = 400
#: Byte order marks of what is no UTF-8; that of UTF-32 begins as that of UTF-16 does.
_OTHER_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE)
#: Bytes that are read at once. Chosen.
_PIECE_BYTES = 2**20
#: Characters of what was found that an error shows. Chosen.
_SHOWN_CHARACTERS = 400


class TextError(ValueError):
    """Text that holds no value: what was found, in which line, what was expected, and what to do."""

    def __init__(self, found: str, line: int | None = None, expected: str | None = None, fix: str | None = None):
        """Keep the facts; the text is what was found, and where."""
        self.found, self.line, self.expected, self.fix = found, line, expected, fix
        super().__init__(found + (f", line {line}" if line is not None else ""))


def line_of(text: str, position: int) -> int:
    """Return the line, from 1, in which a position of a text stands."""
    return text.count("\n", 0, position) + 1


def decode_text(data: bytes) -> str:
    """Return bytes as text; a byte order mark of UTF-8 is left out.

    Raises
    ------
    TextError
        When they are no UTF-8; says in which line.
    """
    fix = "save it as UTF-8"
    if data.startswith(_OTHER_MARKS):
        raise TextError("UTF-16 or UTF-32", expected="text in UTF-8", fix=fix)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        bad_byte = f"the byte 0x{error.object[error.start]:02x}, which is no UTF-8"
        raise TextError(bad_byte, error.object.count(b"\n", 0, error.start) + 1, "text in UTF-8", fix) from None


def read_start(file: IO[bytes], most_bytes: int) -> bytes:
    """Return the first bytes of a file, `most_bytes` at most; memory is taken for what there is alone."""
    pieces: list[bytes] = []
    while (missing_bytes := most_bytes - sum(map(len, pieces))) and (
        piece := file.read(min(_PIECE_BYTES, missing_bytes))
    ):
        pieces.append(piece)
    return b"".join(pieces)


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Return the bytes of a file of at most `most_bytes`; no more are read.

    Raises
    ------
    OSError
        When it cannot be read, or is a device or a pipe, which may never end.
    TextError
        When it is larger.
    """
    if path.exists() and not path.is_file():
        raise OSError(0, "no regular file")
    with path.open("rb") as file:
        data = read_start(file, most_bytes + 1)
        size_bytes = file.seek(0, 2)
    if len(data) > most_bytes:
        fix = "give the right file; data belong into a table"
        raise TextError(f"{size_bytes:,} bytes", expected=f"at most {most_bytes:,} bytes", fix=fix)
    return data


def read_value(path: Path, parse: Callable[[bytes], Any], kind: str, most_bytes: int, title: str | None = None) -> Any:
    """Return the value of a file; no more than `most_bytes` of it are read.

    Parameters
    ----------
    path : Path
        The file.
    parse : callable
        Returns the value of bytes, or raises `TextError`.
    kind : str
        What the file should be, as `YAML`.
    most_bytes : int
        Size from which it is refused [bytes].
    title : str, optional
        What the file is to the user, for messages; its name by default.

    Raises
    ------
    UsageError
        When it cannot be read, is too large, or holds no value; names the line.
    DataError
        When it is a Git LFS pointer.
    """
    title, place = title or path.name, Where(path=str(path))
    refuse_pointer(path)
    try:
        return parse(read_bounded(path, most_bytes))
    except OSError as error:
        raise UsageError(
            f"{title} cannot be read", expected=f"a {kind} file", found=error.strerror or str(error), where=place
        ) from None
    except TextError as error:
        raise UsageError(
            f"{title} is no {kind}",
            expected=error.expected,
            found=error.found[:_SHOWN_CHARACTERS],
            where=place if error.line is None else Where(path=f"{path}, line {error.line}"),
            fix=error.fix or (None if error.line is None else "correct that line"),
        ) from None
