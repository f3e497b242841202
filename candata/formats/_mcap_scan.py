"""One linear pass over an MCAP file, whole or torn: every record that can still be read."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from candata.errors import DataError, Where
from candata.formats._memory import largest_bytes
from candata.lfs import refuse_pointer

#: The eight bytes at both ends of an MCAP file (MCAP format specification, "Magic").
MAGIC = b"\x89MCAP0\r\n"


class Scan:
    """The records of a file in order, those of chunks unpacked, up to its end or to where it is torn.

    Iterate once, then ask. A damaged chunk is skipped and counted: what stands behind it is still read.

    Attributes
    ----------
    whole : bool
        Whether the file ended with its footer.
    damaged_chunks : int
        Chunks whose check sum or compression was broken.
    end : int
        Byte up to which whole records stand.
    """

    def __init__(self, path: Path) -> None:
        """Open nothing yet.

        Raises
        ------
        DataError
            When there is no such file, or it is empty or no MCAP file.
        """
        self.whole, self.damaged_chunks, self.end = False, 0, 0
        self._path = path
        _refuse(path)

    def __iter__(self) -> Iterator[Any]:
        """Yield the records of `mcap.records`; never raises because of what the file holds."""
        from mcap.exceptions import McapError
        from mcap.records import Chunk, Footer
        from mcap.stream_reader import StreamReader

        with self._path.open("rb") as file:
            stream: Any = _Whole(file)
            limit = min(self._path.stat().st_size, largest_bytes())
            records = iter(StreamReader(stream, emit_chunks=True, record_size_limit=limit).records)
            while True:
                try:
                    record = next(records)
                except (McapError, EOFError, StopIteration, ValueError, OverflowError, MemoryError, struct.error):
                    return
                self.end = file.tell()
                self.whole = self.whole or isinstance(record, Footer)
                yield from self._unpacked(record) if isinstance(record, Chunk) else (record,)

    def _unpacked(self, chunk: Any) -> list[Any]:
        """Return the records of a chunk; none where it is damaged."""
        import zstandard
        from mcap.exceptions import McapError
        from mcap.stream_reader import breakup_chunk

        broken = (McapError, EOFError, ValueError, RuntimeError, OverflowError, MemoryError, struct.error)
        try:
            return breakup_chunk(chunk, validate_crc=True)
        except (*broken, zstandard.ZstdError):
            self.damaged_chunks += 1
            return []


class _Whole:
    """A stream that gives all the bytes asked for, or none: the library takes a short read for a whole one."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, count: int) -> bytes:
        """Return `count` bytes; raises EOFError where fewer are left."""
        data = self._file.read(count)
        # One byte is asked for where an opcode stands, and none is 0 (MCAP specification, "Records"): blanks end the
        # file there, as the library would skip them nine bytes at a time.
        if len(data) < count or data == b"\0":
            raise EOFError
        return data


def _refuse(path: Path) -> None:
    """Refuse what cannot be a log, before it is read."""
    where = Where(path=str(path))
    if not path.is_file():
        raise DataError("no such log", where=where, fix="give the file that `candata record-real --out` wrote")
    refuse_pointer(path)
    with path.open("rb") as file:
        head = file.read(len(MAGIC))
    if not head:
        raise DataError("the log is empty: it holds no byte", where=where, fix="record again")
    if head != MAGIC:
        raise DataError(
            "the file is no log", expected="an MCAP file", found=f"a file that begins {head!r}", where=where
        )
