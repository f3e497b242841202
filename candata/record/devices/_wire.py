"""Cutting bytes into frames that begin with a head and say their own length, or that end with a delimiter."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from candata.record.devices._contract import Frame, Framer

FrameKind = Literal["command", "state", "other"]

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
        Bits a second; 0 for a socket, on which a frame takes no time.
    """

    head: bytes
    prefix: int
    size: Callable[[bytes], int]
    longest_bytes: int
    checksum_ok: Callable[[bytes], bool]
    kind: Callable[[bytes], FrameKind]
    baud: int


def wire_time_ns(count: int, baud: int) -> int:
    """Return how long `count` bytes are on the wire [ns]; 0 for a socket (`baud` 0)."""
    return count * BITS_A_BYTE * 1_000_000_000 // baud if baud else 0


class _ReadTimes:
    """When the bytes of a stream were read, as far back as an unfinished frame needs it."""

    def __init__(self, baud: int) -> None:
        """Begin a stream."""
        self._baud = baud
        self._base = 0  # bytes of the stream before the held ones
        self._ends: list[int] = []  # where in the stream each read that still matters ended,
        self._stamps: list[int] = []  # and when it was made
        self._last_stamp: int | None = None

    def add(self, held_bytes: int, stamp_ns: int) -> None:
        """Note a read after which `held_bytes` are held."""
        self._ends.append(self._base + held_bytes)
        self._stamps.append(stamp_ns)

    def frame_stamp(self, end: int, size: int) -> int:
        """Return when the first byte of the frame that ends at held byte `end` was on the wire; later than the last's.

        The read that brought its last byte may have brought bytes behind it: they came later on the wire.
        """
        position = self._base + end
        read_index = bisect_left(self._ends, position)
        later_bytes = self._ends[read_index] - position
        stamp = self._stamps[read_index] - wire_time_ns(later_bytes + size, self._baud)
        if self._last_stamp is not None:
            stamp = max(stamp, self._last_stamp + 1)
        self._last_stamp = stamp
        return stamp

    def forget(self, count: int) -> None:
        """Forget the first `count` held bytes and the reads that ended there."""
        self._base += count
        read_count = bisect_left(self._ends, self._base + 1)
        del self._ends[:read_count], self._stamps[:read_count]


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
        self._times = _ReadTimes(layout.baud)
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
        self._times.add(len(self._held), stamp_ns)
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
                frames.append(Frame(layout.kind(data), data, self._times.frame_stamp(end, size)))
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

    def _drop(self, count: int) -> None:
        """Forget the first `count` held bytes."""
        del self._held[:count]
        self._times.forget(count)


class DelimitedFramer:
    """Cuts a stream into frames that end with one byte; which come out depends on the bytes alone.

    At most `longest_bytes` are held: a longer frame counts as `oversize` and is skipped. What stands before the first
    delimiter, and an unfinished frame at the end, are garbage unless `judge` takes them for a frame.

    Parameters
    ----------
    delimiter : bytes
        The byte that ends a frame.
    longest_bytes : int
        The longest frame, delimiter included.
    judge : callable
        `(frame without its delimiter) -> (kind, data)` of a frame, or the name of the count of why it is none.
        Empty frames are not shown to it.
    baud : int
        Bits a second; 0 for a socket.
    """

    def __init__(
        self,
        delimiter: bytes,
        longest_bytes: int,
        judge: Callable[[bytes], tuple[FrameKind, bytes] | str],
        baud: int = 0,
    ) -> None:
        """Begin with nothing held."""
        self._delimiter, self._longest_bytes, self._judge = delimiter, longest_bytes, judge
        self._held = bytearray()
        self._times = _ReadTimes(baud)
        self._skips = False  # the frame that is being read is too long
        self._counts = dict.fromkeys(("frames", "bytes", "garbage_bytes", "crc_failures", "oversize"), 0)

    @property
    def counts(self) -> Mapping[str, int]:
        """What was met so far: those of every framer, and the names that `judge` gave."""
        return dict(self._counts)

    def feed(self, data: bytes, stamp_ns: int) -> list[Frame]:
        """Return the frames that `data`, read at `stamp_ns`, completes; never raises, whatever the bytes."""
        if not data:
            return []
        searched = len(self._held)
        self._held += data
        self._counts["bytes"] += len(data)
        self._times.add(len(self._held), stamp_ns)
        frames: list[Frame] = []
        begin = 0
        while (end := self._held.find(self._delimiter, max(begin, searched)) + 1) > 0:
            self._close(frames, begin, end)
            begin = end
        if self._skips or len(self._held) - begin >= self._longest_bytes:
            self._counts["garbage_bytes"] += len(self._held) - begin
            self._skips, begin = True, len(self._held)
        self._drop(begin)
        return frames

    def finish(self) -> list[Frame]:
        """Return no frame, and hold nothing: a frame without its end may lack digits or bytes."""
        self._counts["garbage_bytes"] += len(self._held)
        self._skips = False
        self._drop(len(self._held))
        return []

    def _close(self, frames: list[Frame], begin: int, end: int) -> None:
        """Add the frame from `begin` to `end`, or count why it is none."""
        size = end - begin
        if self._skips or size > self._longest_bytes:
            verdict: tuple[FrameKind, bytes] | str = "oversize"
        elif size == 1:
            self._counts["garbage_bytes"] += 1
            return
        else:
            verdict = self._judge(bytes(memoryview(self._held)[begin : end - 1]))
        self._skips = False
        if isinstance(verdict, str):
            self._counts[verdict] = self._counts.get(verdict, 0) + 1
            self._counts["garbage_bytes"] += size
            return
        kind, frame_data = verdict
        frames.append(Frame(kind, frame_data, self._times.frame_stamp(end, size)))
        self._counts["frames"] += 1

    def _drop(self, count: int) -> None:
        """Forget the first `count` held bytes."""
        del self._held[:count]
        self._times.forget(count)


#: So many bytes without one frame are told as another rate, another device or another protocol.
MUTE_BYTES = 4096


def no_frame_finding(framer: Framer, cause: str) -> tuple[str, ...]:
    """Return one line for people when `MUTE_BYTES` came and no frame was among them, else none."""
    counts = framer.counts
    if counts["frames"] or counts["bytes"] < MUTE_BYTES:
        return ()
    return (f"no frame among the first {MUTE_BYTES} bytes: {cause}",)
