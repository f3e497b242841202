"""Text tables as people and programs write them: delimiter, decimal sign, comments, a header or none."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.csv

from candata.errors import DataError, Where

#: pyarrow infers a column's type from its first block; the whole file is one block up to this size.
_BLOCK_BYTES = 1 << 30
#: What is read to learn how a file is written, and how many of its lines are looked at.
_HEAD_BYTES, _HEAD_LINES = 1 << 20, 50
#: Marks that begin a comment: numpy, R and gnuplot; MATLAB.
_COMMENT_MARKS = ("#", "%")
#: Delimiters, in the order in which they are tried; runs of spaces come last.
_DELIMITERS, _SPACES = ("\t", ";", ","), " "
#: From so many columns on, a first line that counts 0, 1, 2 is a header: pandas writes one for columns without names.
_COUNTED_COLUMNS = 3
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(e[+-]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True)
class Dialect:
    """The form of a text table.

    Attributes
    ----------
    names : tuple of str
        Names of the columns; their numbers from 0 where the file has no header.
    has_header : bool
        Whether the names come from the file.
    delimiter : str
        What stands between two values; a space stands for any run of spaces and tabs.
    decimal : str
        Sign between the digits of a number, `.` or `,`.
    first_row : int
        Number of lines before the first row of values.
    first_line : str
        The first line that is no comment.
    """

    names: tuple[str, ...]
    has_header: bool
    delimiter: str
    decimal: str
    first_row: int
    first_line: str


def dialect(path: Path) -> Dialect:
    """Return how a text table is written, as its first lines tell.

    Raises
    ------
    DataError
        When the file is empty, is no UTF-8 text, or has commas both between values and in numbers.
    """
    location = Where(path=str(path))
    lines = _head(path, location)
    start = next(
        (i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(_COMMENT_MARKS)), -1
    )
    if start < 0:
        raise DataError("the table is empty", expected="a first line with the names of columns", where=location)
    rows = [line for line in lines[start : start + _HEAD_LINES] if line.strip()]
    delimiter = _delimiter(rows)
    header, values = _fields(rows[0], delimiter), [_fields(row, delimiter) for row in rows[1:]]
    decimal = (
        "," if delimiter != "," and any(_DECIMAL_COMMA.fullmatch(v) for row in [header, *values] for v in row) else "."
    )
    if delimiter == "," and values and all(len(row) == 2 * len(header) for row in values):
        raise DataError(
            "commas stand between values and in numbers",
            expected="another delimiter beside decimal commas, such as `;`",
            found=f"{len(header)} names and {len(values[0])} values a row",
            where=location,
            fix="write the file with `;` between values, or with decimal points",
        )
    is_counted = len(header) >= _COUNTED_COLUMNS and header == [str(i) for i in range(len(header))]
    if is_counted or not all(_is_number(value, decimal) for value in header):
        return Dialect(tuple(header), True, delimiter, decimal, start + 1, rows[0])
    names = _names_in_comment(lines[:start], delimiter, len(header))
    column_numbers = tuple(map(str, range(len(header))))
    return Dialect(names or column_numbers, bool(names), delimiter, decimal, start, rows[0])


def read_csv(path: Path, layout: Dialect, column_names: list[str]) -> pa.Table:
    """Return these columns of a text table that is written as `layout` says."""
    source: Path | pa.BufferReader = path
    delimiter = layout.delimiter
    if delimiter == _SPACES:
        source, delimiter = pa.BufferReader(_with_tabs(path)), "\t"
    size = path.stat().st_size
    return pa.csv.read_csv(
        source,
        read_options=pa.csv.ReadOptions(
            block_size=min(max(size, 1 << 20), _BLOCK_BYTES), skip_rows=layout.first_row, column_names=layout.names
        ),
        parse_options=pa.csv.ParseOptions(delimiter=delimiter, invalid_row_handler=_skip_comment),
        convert_options=pa.csv.ConvertOptions(include_columns=column_names, decimal_point=layout.decimal),
    )


def _head(path: Path, location: Where) -> list[str]:
    """Return the first lines of a text file."""
    with path.open("rb") as file:
        raw = file.read(_HEAD_BYTES)
        if file.read(1):
            raw = raw[: raw.rfind(b"\n") + 1] or raw
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise DataError(
            "the table is no text",
            expected="a text file in UTF-8",
            found="other bytes, or another encoding",
            where=location,
            fix="save the table as CSV in UTF-8, or give the file the ending of what it is",
        )
    return text.splitlines()


def _delimiter(rows: list[str]) -> str:
    """Return the delimiter: the mark that cuts all rows alike, else the one that the first row holds most of."""
    for mark in (*_DELIMITERS, _SPACES):
        counts = {len(_fields(row, mark)) for row in rows}
        if len(counts) == 1 and counts != {1}:
            return mark
    return max((",", *_DELIMITERS), key=lambda mark: len(_fields(rows[0], mark)))


def _fields(line: str, delimiter: str) -> list[str]:
    """Return the values of one line, without spaces about them."""
    if delimiter == _SPACES:
        return line.split()
    return [
        value.strip() for value in next(csv.reader(io.StringIO(line), delimiter=delimiter, skipinitialspace=True), [])
    ]


def _is_number(value: str, decimal: str) -> bool:
    """Tell whether a text is a number, or an empty cell."""
    try:
        float(value.replace(decimal, ".") or "nan")
    except ValueError:
        return False
    return True


def _names_in_comment(comments: list[str], delimiter: str, count: int) -> tuple[str, ...]:
    """Return the names in the last comment before the values if it has one for each column, else nothing."""
    text = next((line for line in reversed(comments) if line.strip()), "").strip().lstrip("".join(_COMMENT_MARKS))
    for mark in (delimiter, *_DELIMITERS, _SPACES):
        names = _fields(text.strip(), mark)
        if len(names) == count and not any(_is_number(name, ".") for name in names):
            return tuple(names)
    return ()


def _with_tabs(path: Path) -> bytes:
    """Return a file's bytes with one tab for each run of spaces between values."""
    return b"\n".join(b"\t".join(line.split()) for line in path.read_bytes().splitlines())


def _skip_comment(row: pa.csv.InvalidRow) -> str:
    """Return `skip` for a row of another length that is a comment, else `error`."""
    return "skip" if row.text.lstrip().startswith(_COMMENT_MARKS) else "error"
