"""What a device is: how its bytes are cut into frames, and what the frames say.

A `Device` is a hand: joints, fingertips, taxels, requests and replies on a serial port. A `StreamDevice` is all else
that is recorded beside it, and says with `Signal`s what its frames hold. Both lie in one folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError

#: How bytes come: a serial port that is listened to, a TCP server that is connected to, a UDP socket that is bound.
Link = Literal["serial", "tcp", "udp"]


def _unchanged(frame: bytes) -> bytes:
    """Return the frame."""
    return frame


def _no_findings(_framer: Any) -> tuple[str, ...]:
    """Return nothing."""
    return ()


@dataclass(frozen=True)
class Frame:
    """One whole frame, its check passed.

    Attributes
    ----------
    kind : str
        `command` (host to device), `state` (device to host) or `other`.
    data : bytes
        The frame from its head to its check sum.
    stamp_ns : int
        When its first byte was on the wire, on the clock of the stamps that were fed [ns].
    """

    kind: Literal["command", "state", "other"]
    data: bytes
    stamp_ns: int


class Framer(Protocol):
    """Cuts a stream of bytes into frames; holds at most one unfinished frame."""

    @property
    def counts(self) -> Mapping[str, int]:
        """What was met so far: `frames`, `bytes`, `garbage_bytes`, `crc_failures`, `oversize`."""

    def feed(self, data: bytes, stamp_ns: int) -> list[Frame]:
        """Return the frames that `data`, read at `stamp_ns`, completes; never raises, whatever the bytes."""

    def finish(self) -> list[Frame]:
        """Return the frames inside what is held, and hold nothing: for the end of a stream."""


@dataclass(frozen=True)
class States:
    """What n state frames say.

    Attributes
    ----------
    joint_position : (n, J) float64 [rad]
        Joint positions.
    motor_current : (n, J) float64 [A]
        Motor currents.
    motor_temperature : (n, J) float64 [degC]
        Motor temperatures.
    force_counts : (n, F, 3) int16
        Total force of each fingertip in counts; the z axis of the fingertip presses.
    taxel_counts : (n, F, taxels, 3) int16
        Force of each taxel in counts.
    """

    joint_position: NDArray[np.float64]
    motor_current: NDArray[np.float64]
    motor_temperature: NDArray[np.float64]
    force_counts: NDArray[np.int16]
    taxel_counts: NDArray[np.int16]


@dataclass(frozen=True)
class Commands:
    """What n command frames say.

    Attributes
    ----------
    joint_target : (n, J) float64 [rad]
        Joint targets.
    """

    joint_target: NDArray[np.float64]


@dataclass(frozen=True)
class Encoder:
    """How a device's frames are written, for what stands in for it.

    Attributes
    ----------
    command_frames : callable
        `((n, J) float [rad]) -> n command frames`.
    state_frames : callable
        `((n, J) float [rad], (n, F, 3) int, (n, F, taxels, 3) int) -> n state frames`.
    with_heads : callable, optional
        `(frame) -> frame` that says the same, with heads of frames where nothing is read; by default the frame itself.
    """

    command_frames: Callable[[NDArray], list[bytes]]
    state_frames: Callable[[NDArray, NDArray, NDArray], list[bytes]]
    with_heads: Callable[[bytes], bytes] = _unchanged


@dataclass(frozen=True, kw_only=True)
class AnyDevice:
    """What a hand and a stream beside it share.

    Attributes
    ----------
    summary : str
        One line for people.
    rate_hz : float
        Nominal rate of its state frames.
    framer : callable
        `() -> Framer`, a fresh one.
    baud : int
        Bits a second on a serial wire (8N1: ten bits a byte); 0 where it is none.
    link : str
        `serial`, `tcp` or `udp`: how its bytes come.
    port : str
        Where it is heard unless an address is given: a serial port, or HOST:PORT; empty: no default.
    """

    summary: str
    rate_hz: float
    framer: Callable[[], Framer]
    baud: int = 0
    link: Link = "serial"
    port: str = ""


@dataclass(frozen=True)
class Signal:
    """One quantity that a stream carries.

    Attributes
    ----------
    name : str
        Of the episode's channel where there is one (`joint_position`, `object_pose`, `taxels`); `joint_target` is what
        becomes `action`, `wrench` is force then torque. Other names stay in the log.
    shape : tuple of int
        Shape of one value; () for a number.
    unit : str
        From `candata.units`; of a pose that of its position.
    names : tuple of str
        Of the elements along the first axis (joints, fingertips), where they have some.
    """

    name: str
    shape: tuple[int, ...]
    unit: str
    names: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StreamDevice(AnyDevice):
    """A source of frames that each say a few signals.

    Attributes
    ----------
    signals : tuple of Signal
        What its frames hold; empty where a frame says it itself (`signals_of`).
    decode : callable
        `(frames) -> {signal: (n, *shape) float64 or int64}`: whole frames of the kind `state`, many at once, in SI; NaN
        where a frame lacks a value. Of self-describing frames, all hold the signals of the first.
    device_time : str, optional
        Signal, of shape () and unit `ns`, that holds the device's clock; None where it has none.
    signals_of : callable, optional
        `(state frame) -> signals` of a device whose frames describe themselves.
    encode : callable, optional
        `({signal: (n, *shape)}) -> n state frames`; a device that has it can be emulated.
    findings : callable
        `(framer) -> lines for people` on what was met so far: another object, millimetres. Each line is said once.
    configured : callable, optional
        `({name: text}) -> StreamDevice` under settings that stand behind an address, `?name=text&name=text`; raises
        UsageError for those that it lacks.
    """

    signals: tuple[Signal, ...]
    decode: Callable[[Sequence[bytes]], Mapping[str, NDArray]]
    device_time: str | None = None
    signals_of: Callable[[bytes], tuple[Signal, ...]] | None = None
    encode: Callable[[Mapping[str, NDArray]], list[bytes]] | None = None
    findings: Callable[[Any], tuple[str, ...]] = _no_findings
    configured: Callable[[Mapping[str, str]], StreamDevice] | None = None

    def held_signals(self, frame: bytes) -> tuple[Signal, ...]:
        """Return the signals that a state frame holds."""
        return self.signals_of(frame) if self.signals_of else self.signals

    def values(self, frames: Sequence[bytes]) -> dict[str, NDArray]:
        """Return `{signal: (n, *shape)}` of n >= 1 state frames that hold the same signals.

        Raises
        ------
        DataError
            When a frame is no state frame, or the decoder gives arrays of other shapes than are declared.
        """
        decoded = self.decode(frames)
        declared = {s.name: (len(frames), *s.shape) for s in self.held_signals(frames[0])}
        _require_shapes(decoded, declared)
        return {name: decoded[name] for name in declared}


@dataclass(frozen=True, kw_only=True)
class Device(AnyDevice):
    """A hand: a serial device with joints and fingertips.

    Attributes
    ----------
    joint_names, fingertip_names : tuple of str
        In the order of the decoded columns; the names of the built-in scene of this hand.
    taxels : int
        Taxels a fingertip; 0 where it has none.
    newton_per_count : float
        Default scale of the forces; a setting where sources differ.
    count_low, count_high : (3,) int
        Range of a force count along x, y, z: a count at an end is taken for saturated.
    decode_states, decode_commands : callable
        `(frames) -> States`, `(frames) -> Commands`: whole frames of that kind, many at once.
    encoder : Encoder, optional
        Writes its frames; a device that has one can be emulated.
    joint_limits : tuple of (low, high), optional
        Range of each joint [rad]; a hand that has them and an encoder can be polled.
    """

    joint_names: tuple[str, ...]
    fingertip_names: tuple[str, ...]
    taxels: int
    newton_per_count: float
    count_low: tuple[int, int, int]
    count_high: tuple[int, int, int]
    decode_states: Callable[[Sequence[bytes]], States]
    decode_commands: Callable[[Sequence[bytes]], Commands]
    encoder: Encoder | None = None
    joint_limits: tuple[tuple[float, float], ...] | None = None

    def states(self, frames: Sequence[bytes]) -> States:
        """Return what state frames say, of the shapes that the device declares.

        Raises
        ------
        DataError
            When a frame is no state frame, or the decoder gives arrays of other shapes.
        """
        states, n = self.decode_states(frames), len(frames)
        joints, fingertips = len(self.joint_names), len(self.fingertip_names)
        declared = {
            "joint_position": (n, joints),
            "motor_current": (n, joints),
            "motor_temperature": (n, joints),
            "force_counts": (n, fingertips, 3),
            "taxel_counts": (n, fingertips, self.taxels, 3),
        }
        _require_shapes(vars(states), declared)
        return states

    def commands(self, frames: Sequence[bytes]) -> Commands:
        """Return what command frames say, of the shape that the device declares.

        Raises
        ------
        DataError
            When a frame is no command frame, or the decoder gives an array of another shape.
        """
        commands = self.decode_commands(frames)
        _require_shapes(vars(commands), {"joint_target": (len(frames), len(self.joint_names))})
        return commands


def _require_shapes(decoded: Mapping[str, Any], declared: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse arrays of other shapes than the device declares: no log that holds them could be read."""
    for name, shape in declared.items():
        found = np.shape(decoded[name]) if name in decoded else None
        if found != shape:
            raise DataError(
                "the device's decoder disagrees with what the device declares",
                expected=f"{name} {shape}",
                found="no such array" if found is None else str(found),
                fix="mend the device's file; the bytes of the wire are in the log",
            )
