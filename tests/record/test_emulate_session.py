"""Stand-ins of everything beside a hand: one episode, several wires, and what is heard is what was sent."""

from __future__ import annotations

import os
import socket
import threading
import time

import numpy as np
import pytest

from candata.errors import SetupError, UnknownNameError, UsageError
from candata.record.devices import hand, stream
from candata.record.emulate_faults import NO_FAULTS, parse_faults
from candata.record.emulate_script import Script, write_script
from candata.record.emulate_session import SentStream, wrist_wrench, write_session
from candata.record.emulate_streams import (
    TcpOutlet,
    open_outlet,
    play_streams,
    record_line,
    stream_truth,
    wait_for_all,
)
from candata.scenes import load_scene
from candata.schema.episode import Episode, EpisodeMeta

XHAND = hand("xhand")
ARM = tuple(f"joint{number}" for number in range(1, 8))
ROWS, RATE_HZ = 24, 80.0


@pytest.fixture(scope="module")
def scene():
    return load_scene("xarm7_xhand")


@pytest.fixture(scope="module")
def episode(scene) -> Episode:
    """0.3 s of an arm and a hand that move smoothly, an object that turns."""
    names, t = (*ARM, *XHAND.joint_names), np.arange(ROWS) / RATE_HZ
    joints = 0.5 + 0.2 * np.sin(t[:, None] * np.linspace(1, 5, len(names)))
    meta = EpisodeMeta(
        id="e",
        source="sim",
        rate_hz=RATE_HZ,
        scene="xarm7_xhand",
        object="object",
        task="push",
        joint_names=names,
        actuator_names=names,
        fingertip_names=XHAND.fingertip_names,
    )
    force = np.zeros((ROWS, 5, 3))
    force[:, 0] = np.array([0.5, -0.3, 3.0]) * np.linspace(0, 1, ROWS)[:, None]
    arrays = {
        "time_ns": np.arange(ROWS) * 12_500_000,
        "joint_position": joints,
        "action": joints + 0.01,
        "fingertip_force": force,
        "object_pose": np.c_[np.full((ROWS, 3), 0.2), np.cos(t), np.zeros((ROWS, 2)), np.sin(t)],
    }
    return Episode(meta, arrays)


@pytest.fixture(scope="module")
def script(episode) -> Script:
    return write_script(episode, "xhand", XHAND, still_s=0.0)


@pytest.fixture(scope="module")
def streams(script, episode, scene) -> tuple[SentStream, ...]:
    return write_session(script, episode, scene)


class Listener(threading.Thread):
    """Reads bytes of one address until it ends or is told to."""

    def __init__(self, address: str):
        super().__init__(daemon=True)
        self.data, self._over = bytearray(), threading.Event()
        self._socket: socket.socket | None = None
        if address.startswith("udp://"):
            host, _, port = address.removeprefix("udp://").partition(":")
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.bind((host, int(port)))
        elif ":" in address:
            host, _, port = address.partition(":")
            self._socket = socket.create_connection((host, int(port)))
        else:
            self._file = os.open(address, os.O_RDONLY | os.O_NOCTTY)
        if self._socket:
            self._socket.settimeout(0.05)
        self.start()

    def run(self) -> None:
        while not self._over.is_set():
            try:
                data = self._socket.recv(65536) if self._socket else os.read(self._file, 65536)
            except TimeoutError:
                continue
            except OSError:
                break
            if not data:
                break
            self.data += data

    def stop(self) -> bytes:
        """Everything that was heard."""
        if self._socket and self._socket.type == socket.SOCK_DGRAM:
            self._over.set()
        self.join(5)
        assert not self.is_alive()
        if self._socket:
            self._socket.close()
        else:
            os.close(self._file)
        return bytes(self.data)


def play_and_listen(streams, folder, faults=NO_FAULTS, passes=1):
    outlets = [open_outlet(sent, folder, 0) for sent in streams]
    listeners = [Listener(outlet.address) for outlet in outlets]
    assert wait_for_all(outlets, lambda: False)
    rng = np.random.default_rng(1)
    tallies = play_streams(streams, outlets, rng, faults=faults, passes=passes, stop=lambda: False)
    return tallies, [listener.stop() for listener in listeners]


def heard(sent: SentStream, data: bytes):
    device = stream(sent.device_name)
    framer = device.framer()
    states = [f.data for f in framer.feed(data, 1) if f.kind == "state"]
    return (device.values(states) if states else {}), framer


#: By how much a value may differ after its wire: float32; unit quaternions of float32; half a count of an FT300.
STEPS = {"arm": 1e-6, "pose": 1e-7, "wrench": 0.0051, "finger": 0.0, "board": 1e-6}


def test_what_is_heard_is_what_was_sent(streams, tmp_path):
    tallies, data = play_and_listen(streams, tmp_path, passes=2)
    truth = stream_truth(streams, tallies)
    for sent, tally, bytes_heard in zip(streams, tallies, data, strict=True):
        values, framer = heard(sent, bytes_heard)
        assert all(tally.is_whole)
        assert framer.counts["garbage_bytes"] == 0
        assert len(tally.at_s) == pytest.approx(0.6 * sent.rate_hz, abs=1)
        for name in sent.values:
            np.testing.assert_allclose(values[name], truth[f"{sent.name}_{name}"], atol=STEPS[sent.name], rtol=0)
        if "device_time" in values:
            # The wires carry microseconds, a line nanoseconds.
            np.testing.assert_allclose(values["device_time"], truth[f"{sent.name}_device_time_ns"], atol=1000, rtol=0)
    assert list(tmp_path.iterdir()) == []  # the ports are gone


def test_streams_of_one_episode_agree(streams, episode):
    by_name = {sent.name: sent for sent in streams}
    row, at_s = 10, 10 / RATE_HZ
    joints, poses = episode["joint_position"][row], episode["object_pose"][row]
    np.testing.assert_allclose(by_name["arm"].value_at(at_s)["joint_position"], joints[:7], atol=1e-6)
    np.testing.assert_allclose(by_name["board"].value_at(at_s)["joint_position"], joints[7:], atol=1e-6)
    np.testing.assert_allclose(by_name["pose"].value_at(at_s)["object_pose"], poses, atol=1e-12)
    # Between two rows joints lie on a line, and a target is held.
    half = by_name["arm"].value_at(at_s + 0.5 / RATE_HZ)
    middle = (joints[:7] + episode["joint_position"][row + 1, :7]) / 2
    np.testing.assert_allclose(half["joint_position"], middle, atol=1e-6)
    np.testing.assert_allclose(half["joint_target"], episode["action"][row, :7], atol=1e-6)
    # The second pass says the same.
    np.testing.assert_allclose(by_name["pose"].value_at(at_s + ROWS / RATE_HZ)["object_pose"], poses, atol=1e-12)


def test_clocks_of_devices_start_and_drift_on_their_own(streams):
    arm = next(sent for sent in streams if sent.name == "arm")
    assert arm.device_time_ns(0) == 1_234_500_000_000
    assert arm.device_time_ns(100) - arm.device_time_ns(0) == pytest.approx(100e9 * (1 + 20e-6), abs=1)


def test_a_serial_frame_is_written_once_it_has_been_on_the_wire(streams):
    wires = {sent.name: sent.wire_s for sent in streams}
    assert wires["wrench"] == pytest.approx(16 * 10 / 19_200, abs=1e-9)
    assert wires["finger"] == pytest.approx(383 * 10 / 460_800, abs=1e-9)
    assert wires["arm"] == wires["pose"] == 0


def test_the_wrist_feels_what_the_fingertips_do(script, episode, scene):
    """One force: its size is kept, its moment stands upright on it, with a lever of no more than the hand's length."""
    wrench = wrist_wrench(scene, episode["joint_position"][script.row], script)
    sizes = np.linalg.norm(script.force[:, 0], axis=1)
    np.testing.assert_allclose(np.linalg.norm(wrench[:, :3], axis=1), sizes, atol=1e-6)
    np.testing.assert_allclose(np.sum(wrench[:, :3] * wrench[:, 3:], axis=1), 0, atol=1e-6)
    lever = np.linalg.norm(wrench[1:, 3:], axis=1) / sizes[1:]
    assert 0.01 < lever.max() < 0.25  # the longest finger ends 0.206 m from the palm's frame


def test_faults_damage_serial_frames_and_stalls_silence_all(streams, tmp_path):
    faults = parse_faults("garbage:0.3,stall:0.1@0.1")
    tallies, data = play_and_listen(streams, tmp_path, faults)
    for sent, tally, bytes_heard in zip(streams, tallies, data, strict=True):
        assert not [at_s for at_s in tally.at_s if 0.1 <= at_s < 0.2]
        assert bool(tally.faults) == (sent.link == "serial")
        values, _framer = heard(sent, bytes_heard)
        if sent.name != "board":  # a hello may be among the damaged
            assert len(next(iter(values.values()))) == sum(tally.is_whole)


def test_a_slow_client_loses_whole_frames_only(streams):
    arm = next(sent for sent in streams if sent.name == "arm")
    outlet = TcpOutlet(0)
    host, _, port = outlet.address.partition(":")
    with socket.create_connection((host, int(port))) as client:
        assert outlet.has_reader()
        frame = arm.write(arm.value_at(0), 0, 5_000)
        taken = sum(outlet.write(frame) == len(frame) for _ in range(20_000))
        assert taken < 20_000
        received = bytearray()
        client.settimeout(0.2)
        try:
            while data := client.recv(1 << 20):
                received += data
                outlet.write(frame)
                if len(received) > (taken + 5) * len(frame):
                    break
        except TimeoutError:
            pass
    outlet.close()
    _values, framer = heard(arm, bytes(received))
    assert framer.counts["frames"] >= taken
    assert framer.counts["garbage_bytes"] == 0


def test_a_port_that_is_taken_is_named(streams, tmp_path):
    arm = next(sent for sent in streams if sent.name == "arm")
    first = TcpOutlet(0)
    with pytest.raises(SetupError, match=first.address):
        open_outlet(arm, tmp_path, int(first.address.partition(":")[2]))
    first.close()


def test_the_line_that_records_names_every_address(streams, tmp_path):
    outlets = [open_outlet(sent, tmp_path, 0) for sent in streams]
    line = record_line(streams, outlets, tmp_path / "hand")
    for outlet in outlets:
        assert outlet.address in line
        outlet.close()
    assert line.startswith("candata record-real --port")


def test_an_episode_without_an_arm_and_an_unknown_stream_are_refused(script, episode, scene):
    handed = {name: episode[name] for name in ("time_ns", "fingertip_force", "object_pose")}
    names = XHAND.joint_names
    joints = {"joint_position": episode["joint_position"][:, 7:], "action": episode["action"][:, 7:]}
    meta = episode.meta.model_copy(update={"joint_names": names, "actuator_names": names})
    lone = Episode(meta, {**handed, **joints})
    with pytest.raises(UsageError, match="no arm"):
        write_session(write_script(lone, "xhand", XHAND, still_s=0.0), lone, scene, ("arm",))
    with pytest.raises(UnknownNameError, match="tracker"):
        write_session(script, episode, scene, ("tracker",))


def test_a_stop_ends_the_streams(streams, tmp_path):
    outlets = [open_outlet(sent, tmp_path, 0) for sent in streams]
    end_s = time.monotonic() + 0.1
    tallies = play_streams(
        streams, outlets, np.random.default_rng(1), faults=NO_FAULTS, passes=0, stop=lambda: time.monotonic() > end_s
    )
    assert all(tally.at_s for tally in tallies)
