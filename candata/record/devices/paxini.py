"""Paxini PX-6AX (GEN2 DP fingertips) behind its control box: the replies with the 120 taxels of one fingertip.

Source: public readers of the box (the only public description; the maker's manual is not public): 460800 baud; 55 AA 7B
7B, a fixed id, an index, a command, a sub-command of two bytes, an error byte, u16 length of the data, the data, a
check byte, 55 AA 7D 7D. The reply to C0 06 holds six bytes that repeat the request, then 120 taxels of i8, i8, u8: the
record of an XHand's fingertip.

No public source settles what follows, so it is a setting behind the address:

- the check byte of a reply, `check=lrc` (that of a request: what the bytes from the id on lack to a multiple of 256) or
  `check=none`. It is a plain sum: two flipped bits can cancel, and about one damaged reply in 128 passes;
- the scale, which the maker does not publish: taxels stay counts;
- which fingertip answers: a reply does not say. One stream is one fingertip, `tip=NAME` names it.

The box answers only who asks, and candata never asks. So a second receiver must hear the line, or your own program
passes the replies on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.record.devices._contract import Framer, Signal, StreamDevice
from candata.record.devices._settings import check_names, choice
from candata.record.devices._wire import FrameKind, FrameLayout, HeadFramer, no_frame_finding

BAUD = 460_800
HEAD, TAIL = b"\x55\xaa\x7b\x7b", b"\x55\xaa\x7d\x7d"
TAXELS = 120
_COUNTS = [("x", "i1"), ("y", "i1"), ("z", "u1")]
REPLY = np.dtype(
    [
        ("head", "u1", 4),
        ("id", "u1"),
        ("index", "u1"),
        ("command", "u1"),
        ("sub_command", "u1", 2),
        ("error", "u1"),
        ("length", "<u2"),
        ("request", "u1", 6),
        ("taxels", _COUNTS, TAXELS),
        ("check", "u1"),
        ("tail", "u1", 4),
    ]
)
#: What asks for the taxels: sub-command, u16 length 5, then 7B. Without an error byte: its data begin one earlier.
READ, _READ_DATA = b"\xc0\x06", b"\x05\x00\x7b"
_PREFIX, _REQUEST_BYTES = 12, 21
#: Head to length, check byte and tail of a reply.
_FRAME_BYTES = _PREFIX + 1 + len(TAIL)
#: Where the taxels lie in the module's registers. Source: the public readers.
_REGISTERS = (1038).to_bytes(2, "little") + (3 * TAXELS).to_bytes(2, "little")


def check_byte(data: bytes) -> int:
    """Return what the bytes lack to a multiple of 256 (LRC)."""
    return -sum(data) & 0xFF


def _size(prefix: bytes) -> int:
    """Return the length of the frame that begins with `prefix`."""
    if prefix[7:12] == READ + _READ_DATA:
        return _REQUEST_BYTES
    return _FRAME_BYTES + int.from_bytes(prefix[10:12], "little")


def _kind(frame: bytes) -> FrameKind:
    """Return `state` for a reply with taxels and without an error."""
    return "state" if len(frame) == REPLY.itemsize and frame[7:9] == READ and frame[9] == 0 else "other"


def _is_whole(frame: bytes, has_lrc: bool) -> bool:
    """Tell whether a frame ends as it should."""
    return frame.endswith(TAIL) and (not has_lrc or check_byte(frame[4:-5]) == frame[-5])


def _layout(has_lrc: bool) -> FrameLayout:
    """Return the layout of the frames, with or without a check byte in replies."""
    return FrameLayout(
        head=HEAD,
        prefix=_PREFIX,
        size=_size,
        longest_bytes=REPLY.itemsize,
        checksum_ok=partial(_is_whole, has_lrc=has_lrc),
        kind=_kind,
        baud=BAUD,
    )


def decode(replies: Sequence[bytes]) -> dict[str, NDArray]:
    """Return `taxels (n, 1, 120, 3) int64` in counts: x, y with a sign, z, which presses, without.

    Raises
    ------
    DataError
        When a frame is no reply with taxels.
    """
    odd = next((reply for reply in replies if len(reply) != REPLY.itemsize), None)
    if odd is not None:
        raise DataError("a frame holds no taxels", expected=f"{REPLY.itemsize} bytes", found=f"{len(odd)} bytes")
    taxels = np.frombuffer(b"".join(replies), REPLY)["taxels"]
    return {"taxels": np.stack([taxels[axis].astype(np.int64) for axis in "xyz"], axis=-1)[:, None]}


def encode(values: Mapping[str, NDArray]) -> list[bytes]:
    """Return n replies that say `taxels (n, 1, 120, 3)`; what is beyond the range of a count is clipped."""
    counts = np.clip(np.rint(np.asarray(values["taxels"])[:, 0]), (-128, -128, 0), (127, 127, 255))
    rows = np.zeros(len(counts), REPLY)
    rows["head"], rows["tail"], rows["id"], rows["command"] = tuple(HEAD), tuple(TAIL), 0x0E, 0x70
    rows["sub_command"], rows["length"] = tuple(READ), 6 + 3 * TAXELS
    rows["request"][:, :5] = tuple(_READ_DATA[2:] + _REGISTERS)
    for number, axis in enumerate("xyz"):
        rows["taxels"][axis] = counts[..., number]
    return [_sealed(row.tobytes()) for row in rows]


def _sealed(frame: bytes) -> bytes:
    """Return the frame with its check byte."""
    return frame[:-5] + bytes([check_byte(frame[4:-5])]) + TAIL


def findings(framer: Framer) -> tuple[str, ...]:
    """Return what people should know of a stream: check bytes that all fail, or nothing that is a frame."""
    counts = framer.counts
    if not counts["frames"] and counts["crc_failures"] >= 10:
        return ("every check byte fails: if the rest looks right, set check=none, and say so to candata's authors",)
    return no_frame_finding(framer, f"another baud rate than {BAUD}, another device, or nobody polls the box")


def configured(settings: Mapping[str, str]) -> StreamDevice:
    """Return the fingertip under `check` (`lrc`, `none`) and `tip` (its name).

    Raises
    ------
    UsageError
        When a setting is unknown or wrong.
    """
    check_names(settings, ("check", "tip"))
    has_lrc = choice(settings, "check", ("lrc", "none"), "lrc") == "lrc"
    return StreamDevice(
        summary="Paxini PX-6AX fingertip behind its control box, serial at 460800 baud: 120 taxels",
        rate_hz=83.0,
        baud=BAUD,
        framer=partial(HeadFramer, _layout(has_lrc)),
        signals=(Signal("taxels", (1, TAXELS, 3), "count", (settings.get("tip", "fingertip"),)),),
        decode=decode,
        encode=encode,
        findings=findings,
        configured=configured,
    )


DEVICE = configured({})
