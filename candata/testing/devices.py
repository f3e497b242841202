"""What every device keeps: frames say what was encoded, garbage costs no sound one, an emulation is recorded."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from candata.errors import MissingExtraError
from candata.record.devices import DEVICES, Device, Encoder, Frame
from candata.schema.episode import Episode, EpisodeMeta
from candata.testing._claims import registered_name, require, require_words

ROWS = 24


@dataclass(frozen=True)
class Rows:
    """Values that a device sends, and their frames in turn: request, reply, request, reply."""

    joint_target: NDArray[np.float64]
    joint_position: NDArray[np.float64]
    force_counts: NDArray[np.int64]
    taxel_counts: NDArray[np.int64]
    frames: tuple[bytes, ...]


class DeviceConformance:
    """Conformance of one device.

    Attributes
    ----------
    device : Device
        The constant of the plug-in.
    joint_range_rad : (float, float)
        Angles that the wire carries for every joint.
    angle_step_rad : float
        By how much an angle may differ after the wire: its resolution.
    """

    device: ClassVar[Device]
    joint_range_rad: ClassVar[tuple[float, float]] = (0.0, 1.0)
    angle_step_rad: ClassVar[float] = 1e-3

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, and read what it is."""
        require_words(DEVICES, self.device)

    def test_what_it_declares_makes_sense(self) -> None:
        """Names once each, positive rates and scales, ranges that hold something."""
        device = self.device
        for names in (device.joint_names, device.fingertip_names):
            require(len(set(names)) == len(names), f"a name stands twice: {', '.join(names)}")
        require(device.joint_names, "there are no joints")
        for field in ("baud", "rate_hz", "newton_per_count"):
            require(getattr(device, field) > 0, f"{field} is not positive")
        require(device.taxels >= 0, "taxels is negative")
        require((np.array(device.count_low) < device.count_high).all(), "count_low is not below count_high")

    def test_what_is_encoded_is_decoded(self) -> None:
        """Angles within the wire's resolution, counts as they are, in the declared shapes."""
        device, rows = self.device, self._rows()
        commands, states = device.commands(rows.frames[::2]), device.states(rows.frames[1::2])
        for channel, encoded, decoded in (
            ("joint_target", rows.joint_target, commands.joint_target),
            ("joint_position", rows.joint_position, states.joint_position),
        ):
            error_rad = float(np.abs(encoded - decoded).max())
            require(error_rad <= self.angle_step_rad, f"{channel} is off by {error_rad:.3g} rad after the wire")
        require(np.array_equal(states.force_counts, rows.force_counts), "force_counts differ after the wire")
        require(np.array_equal(states.taxel_counts, rows.taxel_counts), "taxel_counts differ after the wire")

    def test_no_frames_are_no_rows(self) -> None:
        """Of the declared shapes too."""
        self.device.states([])
        self.device.commands([])

    def test_frames_do_not_depend_on_how_the_bytes_were_read(self) -> None:
        """A read ends anywhere, and the kinds are told apart."""
        rows = self._rows()
        stream = b"".join(rows.frames)
        for size in (1, 7, 64, len(stream)):
            frames = self._read(stream, size)
            require([f.data for f in frames] == list(rows.frames), f"reads of {size} bytes give other frames")
        require({f.kind for f in frames[::2]} == {"command"}, "a request is not of the kind `command`")
        require({f.kind for f in frames[1::2]} == {"state"}, "a reply is not of the kind `state`")
        stamps = [f.stamp_ns for f in self._read(stream, 64)]
        require(all(np.diff(stamps) > 0), "stamps do not increase")

    def test_garbage_costs_no_sound_frame(self) -> None:
        """Noise, cut frames and heads of frames that never end stand between sound ones."""
        rows, rng = self._rows(), np.random.default_rng(4)
        for number, frame in enumerate(rows.frames):
            noise, cut_frame = rng.bytes(int(rng.integers(1, 40))), frame[: int(rng.integers(1, len(frame)))]
            stream = [*rows.frames[:number], noise, cut_frame, *rows.frames[number:]]
            frames_read = [f.data for f in self._read(b"".join(stream), 64)]
            require(_is_subsequence(frames_read, rows.frames), f"garbage before frame {number} costs a sound frame")

    def test_no_bytes_break_it(self) -> None:
        """A framer never raises, and a state that comes out of noise decodes."""
        for seed in range(5):
            for frame in self._read(np.random.default_rng(seed).bytes(20_000), 997):
                if frame.kind == "state":
                    self.device.states([frame.data])

    def test_it_is_emulated_and_recorded(self, tmp_path: Path) -> None:
        """`candata emulate` plays it, `candata record-real` hears it, and the log is read back as it was sent."""
        from candata.record.emulate_script import write_script
        from candata.record.logs import read_log

        name = registered_name(DEVICES, self.device)
        script = write_script(self._episode(), name, self.device, rate_hz=None, still_s=0.0)
        try:
            _record(self.device, name, script, tmp_path / "log.mcap")
        except MissingExtraError as error:
            _skip(str(error))
        log = read_log(tmp_path / "log.mcap")
        require(len(log.force_counts), "the recording holds no states")
        sent_states = self.device.states(script.states)
        recorded_rows, sent_rows = (
            _distinct_rows(rows.joint_position, rows.force_counts) for rows in (log, sent_states)
        )
        require(recorded_rows <= sent_rows, "the log holds states that were not sent")
        require((log.taxel_counts is None) == (self.device.taxels == 0), "taxels are in the log where there are none")

    def _encoder(self) -> Encoder:
        """Return the encoder; skips the test where the device has none."""
        if self.device.encoder is None:
            _skip("the device has no encoder: nothing can be encoded")
        return self.device.encoder  # type: ignore[return-value]

    def _rows(self) -> Rows:
        """Return random values and their frames."""
        device, encoder, rng = self.device, self._encoder(), np.random.default_rng(1)
        joints, tips = len(device.joint_names), len(device.fingertip_names)
        target, position = (rng.uniform(*self.joint_range_rad, (ROWS, joints)) for _ in range(2))
        force = rng.integers(device.count_low, np.add(device.count_high, 1), (ROWS, tips, 3))
        taxels = rng.integers(device.count_low, np.add(device.count_high, 1), (ROWS, tips, device.taxels, 3))
        pairs = zip(encoder.command_frames(target), encoder.state_frames(position, force, taxels), strict=True)
        return Rows(target, position, force, taxels, tuple(frame for pair in pairs for frame in pair))

    def _read(self, stream: bytes, size: int) -> list[Frame]:
        """Return the frames of a stream that is read in pieces, one a millisecond."""
        framer = self.device.framer()
        frames: list[Frame] = []
        for number, start in enumerate(range(0, len(stream), size)):
            frames += framer.feed(stream[start : start + size], (number + 1) * 1_000_000)
        return frames + framer.finish()

    def _episode(self) -> Episode:
        """Return an episode that the device can play: slow motion and a press on every fingertip."""
        device, rows = self.device, ROWS
        low, high = self.joint_range_rad
        wave = low + (high - low) * (0.5 - 0.5 * np.cos(np.linspace(0, 6, rows)))
        positions = np.repeat(wave[:, None], len(device.joint_names), axis=1)
        meta = EpisodeMeta(
            id="conformance",
            source="sim",
            rate_hz=device.rate_hz,
            joint_names=device.joint_names,
            actuator_names=device.joint_names,
            fingertip_names=device.fingertip_names,
        )
        arrays = {
            "time_ns": np.round(np.arange(rows) * 1e9 / device.rate_hz),
            "joint_position": positions,
            "action": positions,
        }
        if device.fingertip_names:
            arrays["fingertip_force"] = np.tile([0.0, 0.0, 1.0], (rows, len(device.fingertip_names), 1))
        return Episode(meta, arrays)


def _distinct_rows(joints: NDArray, counts: NDArray) -> set[bytes]:
    """Return each row of joints and counts once, as bytes."""
    return {row.tobytes() for row in np.c_[joints, counts.reshape(len(counts), -1)]}


def _is_subsequence(items: Sequence[bytes], subsequence: Sequence[bytes]) -> bool:
    """Tell whether all that is wanted is found, in its order; more may be found between."""
    iterator = iter(items)
    return all(any(frame == item for item in iterator) for frame in subsequence)


def _record(device: Device, name: str, script: object, out: Path) -> None:
    """Play a script on a pseudo-terminal until it is over, while the recorder listens."""
    from candata.record.emulate import play, wait_for_reader
    from candata.record.emulate_line import Line
    from candata.record.recorder import record
    from candata.record.recorder_values import RecorderSettings

    emulation_over, recording_over = threading.Event(), threading.Event()
    with Line() as line:

        def send() -> None:
            wait_for_reader(line, emulation_over.is_set)
            play(script, line, np.random.default_rng(0), passes=0, stop=emulation_over.is_set)  # type: ignore[arg-type]

        sender = threading.Thread(target=send, daemon=True)
        sender.start()
        try:
            settings = RecorderSettings(duration_s=None, calibrate_s=0.0, reserve_bytes=0)
            report = record(
                device,
                line.port,
                out,
                name=name,
                settings=settings,
                stop=recording_over.is_set,
                show=lambda view: recording_over.set() if view.frames["state"] >= ROWS else None,
            )
        finally:
            emulation_over.set()
            sender.join()
    if report.failure is not None:
        raise report.failure


def _skip(reason: str) -> None:
    """Skip the test that is running."""
    import pytest

    pytest.skip(reason)
