"""What the footer of a Parquet file claims, read without pyarrow.

pyarrow ends the process (`std::terminate`) where a damaged footer is asked for a column chunk that does not fit itself
(`Definition level histogram size mismatch`; seen in 26.0.1). Sources: the compact protocol of Thrift
(https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md) and `parquet.thrift` of
https://github.com/apache/parquet-format, whose field numbers stand below.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

_MAGIC = b"PAR1"
#: Fields by number: of the file the row groups; of one its chunks and rows; of a chunk its record, and in that its
#: values, their size before compression, and the path of the column.
_ROW_GROUPS, _CHUNKS, _ROWS, _RECORD, _VALUES, _BYTES, _PATH = 4, 1, 3, 3, 5, 6, 3


class ColumnChunk(NamedTuple):
    """What a file claims of one column in one row group: its path, rows, values and size before compression."""

    column: str
    rows: int
    values: int
    size_bytes: int


def read_chunks(path: Path) -> list[list[ColumnChunk]]:
    """Return what a file claims of each column of each row group.

    Raises
    ------
    OSError
        When it cannot be read.
    ValueError
        When it is no Parquet file, or its footer is damaged.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - 8, 0))
        tail = file.read(8)
        length = int.from_bytes(tail[:4], "little")
        if tail[4:] != _MAGIC or length + 12 > size:
            raise ValueError("no Parquet file: its footer is missing")
        file.seek(size - 8 - length)
        footer = _Compact(file.read(length))
    try:
        return [
            [
                ColumnChunk(b".".join(record[_PATH]).decode(), group[_ROWS], record[_VALUES], record[_BYTES])
                for record in (chunk[_RECORD] for chunk in group[_CHUNKS])
            ]
            for group in footer.struct()[_ROW_GROUPS]
        ]
    except (IndexError, KeyError, TypeError, AttributeError, RecursionError):
        raise ValueError("the footer is damaged") from None


class _Compact:
    """Values of the compact protocol, one behind another."""

    def __init__(self, data: bytes):
        self._data, self._at = data, 0

    def struct(self) -> dict[int, Any]:
        """Return the fields of a struct by number."""
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._signed()
            kind = head & 15
            fields[number] = kind == 1 if kind in (1, 2) else self._value(kind)
        return fields

    def _value(self, kind: int) -> Any:
        """Return a value of a kind; of truth values a byte."""
        if kind in (1, 2, 3):
            return self._byte()
        if kind in (4, 5, 6):
            return self._signed()
        if kind in (7, 8):
            length = 8 if kind == 7 else self._unsigned()
            self._at += length
            if self._at > len(self._data):
                raise IndexError
            return self._data[self._at - length : self._at]
        if kind in (9, 10):
            head = self._byte()
            count = head >> 4 if head >> 4 != 15 else self._unsigned()
            return [self._value(head & 15) for _ in range(count)]
        if kind == 12:
            return self.struct()
        raise IndexError  # maps: no record of Parquet has one

    def _byte(self) -> int:
        """Return the next byte."""
        self._at += 1
        return self._data[self._at - 1]

    def _unsigned(self) -> int:
        """Return a number, seven bits a byte, the lowest first."""
        value = shift = 0
        while (byte := self._byte()) & 128:
            value |= (byte & 127) << shift
            shift += 7
            if shift > 63:
                raise IndexError
        return value | byte << shift

    def _signed(self) -> int:
        """Return a number whose lowest bit is its sign."""
        value = self._unsigned()
        return (value >> 1) ^ -(value & 1)
