"""One linear pass over an MCAP file, whole or torn: every record that can still be read."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pyarrow as pa

from candata.datasets.bounded import LIMIT_RATIO, require_bounded
from candata.errors import DataError, Where
from candata.formats._memory import largest_bytes
from candata.lfs import refuse_pointer

#: The eight bytes at both ends of an MCAP file (MCAP format specification, "Magic").
MAGIC = b"\x89MCAP0\r\n"

#: Compressions of a chunk that are unpacked here.
_CODECS = ("zstd", "lz4")
#: What a chunk of any size may unfold to [bytes].
_CHUNK_BYTES = 64 * 2**20
#: What a record takes in memory beside its bytes. Source: measured with Python 3.11.
_RECORD_BYTES = 200


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
        """Yield the records of `mcap.records`, whatever the file holds.

        Raises
        ------
        DataError
            When its chunks unfold to more than is read at once.
        """
        from mcap.exceptions import McapError
        from mcap.records import Chunk, Footer
        from mcap.stream_reader import StreamReader

        with self._path.open("rb") as file:
            stream: Any = _FullReads(file)
            limit, unfolded_bytes = min(self._path.stat().st_size, largest_bytes()), 0
            records = iter(StreamReader(stream, emit_chunks=True, record_size_limit=limit).records)
            while True:
                try:
                    record = next(records)
                except (McapError, EOFError, StopIteration, ValueError, OverflowError, MemoryError, struct.error):
                    return
                self.end = file.tell()
                self.whole = self.whole or isinstance(record, Footer)
                if not isinstance(record, Chunk):
                    yield record
                    continue
                records_of_chunk = self._unpack_chunk(record)
                unfolded_bytes += record.uncompressed_size * bool(records_of_chunk) + _RECORD_BYTES * len(
                    records_of_chunk
                )
                require_bounded(self._path, unfolded_bytes, limit)
                yield from records_of_chunk

    def _unpack_chunk(self, chunk: Any) -> list[Any]:
        """Return the records of a chunk; none where it is damaged."""
        from mcap.exceptions import McapError
        from mcap.stream_reader import breakup_chunk

        try:
            if chunk.compression in _CODECS:
                if chunk.uncompressed_size > max(_CHUNK_BYTES, LIMIT_RATIO * len(chunk.data)):
                    raise ValueError("a size that no chunk has")
                # mcap makes as much room as the compressed bytes ask for; this, as much as the chunk says it takes.
                data = pa.Codec(chunk.compression).decompress(chunk.data, chunk.uncompressed_size, asbytes=True)
                chunk = dataclasses.replace(chunk, compression="", data=data)
            return breakup_chunk(chunk, validate_crc=True)
        except (McapError, EOFError, ValueError, RuntimeError, OverflowError, MemoryError, OSError, struct.error):
            self.damaged_chunks += 1
            return []


class _FullReads:
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
    location = Where(path=str(path))
    if not path.is_file():
        raise DataError("no such log", where=location, fix="give the file that `candata record-real --out` wrote")
    refuse_pointer(path)
    with path.open("rb") as file:
        head = file.read(len(MAGIC))
    if not head:
        raise DataError("the log is empty: it holds no byte", where=location, fix="record again")
    if head != MAGIC:
        raise DataError(
            "the file is no log", expected="an MCAP file", found=f"a file that begins {head!r}", where=location
        )
