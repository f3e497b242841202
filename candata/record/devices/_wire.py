"""Cutting bytes into frames that begin with a head and say their own length."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from candata.record.devices._contract import Frame

#: Bits on the wire for a byte: start, eight data, stop (8N1).
BITS_A_BYTE = 10


@dataclass(frozen=True)
class FrameLayout:
    """How the frames of a wire look.

    Attributes
    ----------
    head : bytes
        What every frame begins with.
    prefix : int
        Bytes from the head on that tell the length.
    size : callable
        `(prefix bytes) -> int`: length of the whole frame, head and check sum included.
    longest : int
        A frame that claims to be longer is none.
    sound : callable
        `(whole frame) -> bool`: its check sum is right.
    kind : callable
        `(whole frame) -> kind`.
    baud : int
        Bits a second.
    """

    head: bytes
    prefix: int
    size: Callable[[bytes], int]
    longest_bytes: int
    checksum_ok: Callable[[bytes], bool]
    kind: Callable[[bytes], Literal["command", "state", "other"]]
    baud: int


def wire_time_ns(count: int, baud: int) -> int:
    """Return how long `count` bytes are on the wire [ns]."""
    return count * BITS_A_BYTE * 1_000_000_000 // baud


class HeadFramer:
    """Cuts a stream into frames; which frames come out depends on the bytes alone, not on how they were read.

    After a failure the search goes on one byte past the head, never behind the claimed length, so a damaged frame
    costs no sound one. What looks like the beginning of a frame is held until the length that it claims has
    arrived. A wrong length therefore delays what follows by at most `layout.longest` bytes; `finish` gives up the
    wait at the end of a stream. At most `layout.longest - 1` bytes are held.
    """

    def __init__(self, layout: FrameLayout) -> None:
        """Begin with nothing held."""
        self._layout = layout
        self._held = bytearray()
        self._base = 0  # bytes of the stream before the held ones
        self._ends: list[int] = []  # where in the stream each read that still matters ended,
        self._stamps: list[int] = []  # and when it was made
        self._last_stamp: int | None = None
        self._counts = dict.fromkeys(("frames", "bytes", "garbage_bytes", "crc_failures", "oversize"), 0)

    @property
    def counts(self) -> Mapping[str, int]:
        """What was met so far: `frames`, `bytes`, `garbage_bytes`, `crc_failures`, `oversize`."""
        return dict(self._counts)

    @property
    def held_bytes(self) -> int:
        """Bytes of the unfinished frame."""
        return len(self._held)

    def feed(self, data: bytes, stamp_ns: int) -> list[Frame]:
        """Return the frames that `data` completes; never raises, whatever the bytes.

        Parameters
        ----------
        data : bytes
            What was read; may be empty.
        stamp_ns : int
            When the read returned [ns]: taken for the moment at which its last byte had arrived.
        """
        if not data:
            return []
        self._held += data
        self._counts["bytes"] += len(data)
        self._ends.append(self._base + len(self._held))
        self._stamps.append(stamp_ns)
        frames: list[Frame] = []
        self._drop(self._cut(frames, 0))
        return frames

    def finish(self) -> list[Frame]:
        """Return the frames inside what is held, and hold nothing: for the end of a stream."""
        frames: list[Frame] = []
        begin = 0
        while begin < len(self._held):
            begin = self._cut(frames, begin)
            if begin < len(self._held):
                begin = self._skip(begin, begin + 1)
        self._drop(begin)
        return frames

    def _cut(self, frames: list[Frame], begin: int) -> int:
        """Add the whole frames from `begin` on; return where the unfinished rest begins."""
        buffer, layout = self._held, self._layout
        while True:
            begin = self._skip(begin, self._next_head(begin))
            if begin + layout.prefix > len(buffer):
                return begin
            size = layout.size(bytes(buffer[begin : begin + layout.prefix]))
            end = begin + size
            if size > layout.longest_bytes:
                self._counts["oversize"] += 1
                begin = self._skip(begin, begin + 1)
            elif end > len(buffer):
                return begin
            elif layout.checksum_ok(data := bytes(memoryview(buffer)[begin:end])):
                frames.append(Frame(layout.kind(data), data, self._stamp(end, size)))
                self._counts["frames"] += 1
                begin = end
            else:
                self._counts["crc_failures"] += 1
                begin = self._skip(begin, begin + 1)

    def _next_head(self, begin: int) -> int:
        """Return where the next head begins, whole or cut off by the end of what is held."""
        head, buffer = self._layout.head, self._held
        position = buffer.find(head, begin)
        if position >= 0:
            return position
        for length in range(min(len(head) - 1, len(buffer) - begin), 0, -1):
            if buffer.endswith(head[:length]):
                return len(buffer) - length
        return len(buffer)

    def _skip(self, begin: int, end: int) -> int:
        """Count the bytes between as garbage; return `end`."""
        self._counts["garbage_bytes"] += end - begin
        return end

    def _stamp(self, end: int, size: int) -> int:
        """Return when the first byte of the frame that ends at `end` was on the wire; later than the last frame's.

        The read that brought its last byte may have brought bytes behind it: they came later on the wire.
        """
        position = self._base + end
        read_index = bisect_left(self._ends, position)
        later_bytes = self._ends[read_index] - position
        stamp = self._stamps[read_index] - wire_time_ns(later_bytes + size, self._layout.baud)
        if self._last_stamp is not None:
            stamp = max(stamp, self._last_stamp + 1)
        self._last_stamp = stamp
        return stamp

    def _drop(self, count: int) -> None:
        """Forget the first `count` held bytes and the reads that ended there."""
        del self._held[:count]
        self._base += count
        read_count = bisect_left(self._ends, self._base + 1)
        del self._ends[:read_count], self._stamps[:read_count]
