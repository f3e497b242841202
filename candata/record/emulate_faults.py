"""Faults that an emulated wire makes: what they are called, and what they do to a frame."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from candata.errors import UnknownNameError, UsageError

#: What a receiver at another baud rate makes of a start bit and runs of equal bits.
_NOISE = np.array([0x00, 0x80, 0xC0, 0xE0, 0xF0, 0xF8, 0xFC, 0xFE, 0xFF], np.uint8)


#: Range of a latency timer [s]. Source: FTDI AN232B-04.
LEAST_BURST_S, MOST_BURST_S = 0.001, 0.255


@dataclass(frozen=True)
class Faults:
    """What goes wrong on the wire.

    Attributes
    ----------
    bitflip, truncate, head, garbage : float
        Share of the frames that have one bit flipped, lose their end, hold heads of frames in bytes that mean
        nothing, or arrive as noise of the same length. A frame has one fault at most.
    stalls : tuple of (float, float)
        `(from_s, for_s)`: nothing is sent.
    unplug : (float, float or None) or None
        `(from_s, for_s)`: the port goes away; for good where `for_s` is None.
    burst_s : float
        Bytes are held until a timer of this period runs out, as a USB adapter does; 0: none.
    """

    bitflip: float = 0.0
    truncate: float = 0.0
    head: float = 0.0
    garbage: float = 0.0
    stalls: tuple[tuple[float, float], ...] = ()
    unplug: tuple[float, float | None] | None = None
    burst_s: float = 0.0

    @property
    def shares(self) -> dict[str, float]:
        """Share of the frames with each fault of a frame."""
        return {name: getattr(self, name) for name in _OF_FRAMES}


NO_FAULTS = Faults()
_OF_FRAMES = ("bitflip", "truncate", "head", "garbage")
_WORDS = {
    **{name: f"{name}:P" for name in _OF_FRAMES},
    "stall": "stall:S@T",
    "unplug": "unplug[:S]@T",
    "burst": "burst:S",
}


def parse_faults(text: str) -> Faults:
    """Return the faults in `bitflip:0.01,stall:2@5,unplug@9,burst:0.016`.

    `P` is a share of the frames; a stall lasts S seconds from second T on; `unplug:S@T` comes back after S seconds,
    `unplug@T` never; a burst holds all bytes until a timer of S seconds runs out, again and again.

    Raises
    ------
    UsageError
        When a word is not known or not well formed, or the shares sum to more than 1.
    """
    shares: dict[str, float] = {}
    stalls: list[tuple[float, float]] = []
    unplug: tuple[float, float | None] | None = None
    burst_s = 0.0
    for word in filter(None, (word.strip() for word in text.split(","))):
        name = re.split("[:@]", word)[0]
        if name not in _WORDS:
            raise UnknownNameError("fault", name, _WORDS)
        number = r"(\d+\.?\d*|\.\d+)"
        pattern = {"stall": f":{number}@{number}", "unplug": f"(?::{number})?@{number}"}.get(name, f":{number}")
        match = re.fullmatch(name + pattern, word)
        if match is None or name in shares or (name == "unplug" and unplug) or (name == "burst" and burst_s):
            raise UsageError(f"the fault {word!r} is not well formed", expected=f"{_WORDS[name]}, numbers, once")
        values = [None if value is None else float(value) for value in match.groups()]
        if name == "stall":
            stalls.append((float(values[1] or 0), float(values[0] or 0)))
        elif name == "unplug":
            unplug = (float(values[1] or 0), values[0])
        elif name == "burst":
            burst_s = _burst(float(values[0] or 0))
        else:
            shares[name] = float(values[0] or 0)
    if sum(shares.values()) > 1:
        raise UsageError("the shares of damaged frames sum to more than 1", found=f"{sum(shares.values()):g}")
    return Faults(**shares, stalls=tuple(sorted(stalls)), unplug=unplug, burst_s=burst_s)


def _burst(period_s: float) -> float:
    """Return the period of a latency timer.

    Raises
    ------
    UsageError
        When it is out of the range of such timers.
    """
    if not LEAST_BURST_S <= period_s <= MOST_BURST_S:
        expected = f"{LEAST_BURST_S:g} to {MOST_BURST_S:g} s, as latency timers have"
        raise UsageError("a burst of this period is none", expected=expected, found=f"{period_s:g} s")
    return period_s


def with_fault(
    frame: bytes, faults: Faults, with_heads: Callable[[bytes], bytes], rng: np.random.Generator
) -> tuple[bytes, str | None]:
    """Return the bytes that arrive in place of a frame, and the name of the fault, if it has one.

    Parameters
    ----------
    frame : bytes
        The frame.
    faults : Faults
        Shares of the faults.
    with_heads : callable
        Writes heads into a frame without changing what it says.
    rng : numpy.random.Generator
        Draws once for a frame without a fault.
    """
    chance = rng.random()
    for name, share in faults.shares.items():
        if chance < share:
            return _DAMAGE[name](frame, with_heads, rng), name
        chance -= share
    return frame, None


def _bitflip(frame: bytes, _heads: Callable[[bytes], bytes], rng: np.random.Generator) -> bytes:
    """Return the frame with one bit flipped."""
    bit = int(rng.integers(len(frame) * 8))
    data = bytearray(frame)
    data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def _truncate(frame: bytes, _heads: Callable[[bytes], bytes], rng: np.random.Generator) -> bytes:
    """Return the frame without its end."""
    return frame[: int(rng.integers(1, len(frame)))]


def _head(frame: bytes, heads: Callable[[bytes], bytes], _rng: np.random.Generator) -> bytes:
    """Return the frame with heads inside."""
    return heads(frame)


def _garbage(frame: bytes, _heads: Callable[[bytes], bytes], rng: np.random.Generator) -> bytes:
    """Return noise of the same length, half of it as of another baud rate, half of any bytes."""
    runs = _NOISE[rng.integers(len(_NOISE), size=len(frame))]
    return np.where(rng.random(len(frame)) < 0.5, runs, np.frombuffer(rng.bytes(len(frame)), np.uint8)).tobytes()


_DAMAGE = {"bitflip": _bitflip, "truncate": _truncate, "head": _head, "garbage": _garbage}
