"""An emulated hand on its pseudo-terminal: what a reader gets is what was sent, or is counted as lost."""

from __future__ import annotations

import os
import threading
import time
import tty

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from candata.errors import SetupError, UsageError
from candata.formats import table
from candata.record import emulate as emulation
from candata.record import emulate_files as files
from candata.record.devices import Frame, device
from candata.record.emulate import Transmission, play, wait_for_reader
from candata.record.emulate_faults import parse_faults
from candata.record.emulate_line import Line
from candata.record.emulate_script import Script, write_script
from candata.schema.episode import Episode, EpisodeMeta

XHAND = device("xhand")
ROWS, RATE_HZ, STILL_S = 30, 110.0, 0.1
ROW_BYTES = 297 + 2217


@pytest.fixture(scope="module")
def script() -> Script:
    """41 rows of a hand on a one-axis wrist with an object: 0.37 s at 110 Hz."""
    rng = np.random.default_rng(9)
    names = ("wrist_x", *XHAND.joint_names)
    meta = EpisodeMeta(
        id="e",
        source="sim",
        rate_hz=80,
        scene="xhand_tabletop",
        object="object",
        task="push",
        joint_names=names,
        actuator_names=names,
        fingertip_names=XHAND.fingertip_names,
    )
    arrays = {
        "time_ns": np.arange(ROWS) * 12_500_000,
        "joint_position": rng.normal(size=(ROWS, 13)),
        "action": rng.normal(size=(ROWS, 13)),
        "fingertip_force": rng.uniform(-4, 12, (ROWS, 5, 3)),
        "object_pose": np.c_[rng.normal(size=(ROWS, 3)), np.ones(ROWS), np.zeros((ROWS, 3))],
    }
    return write_script(Episode(meta, arrays), "xhand", XHAND, rate_hz=RATE_HZ, still_s=STILL_S)


class Reader(threading.Thread):
    """Reads a port until it goes away, as a recorder does."""

    def __init__(self, port: str):
        super().__init__(daemon=True)
        self.port, self.bytes = port, 0
        self.frames: list[Frame] = []
        self.port_file = os.open(port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.port_file)

    def run(self):
        wall_ns = time.time_ns() - time.monotonic_ns()
        framer = XHAND.framer()
        while data := self.read():
            self.bytes += len(data)
            self.frames += framer.feed(data, time.monotonic_ns() + wall_ns)
        self.frames += framer.finish()
        self.counts = dict(framer.counts)
        os.close(self.port_file)

    def read(self) -> bytes:
        try:
            return os.read(self.port_file, 4096)
        except OSError:
            return b""

    def of(self, kind: str) -> list[Frame]:
        return [frame for frame in self.frames if frame.kind == kind]


def heard(script: Script, faults: str = "", **options) -> tuple[Transmission, Reader]:
    """Play a script to a reader that takes all it can."""
    with Line() as line:
        reader = Reader(line.port)
        reader.start()
        sent = play(script, line, np.random.default_rng(3), faults=parse_faults(faults), **options)
    reader.join(5)
    return sent, reader


@pytest.fixture(scope="module")
def whole(script) -> tuple[Transmission, Reader]:
    return heard(script)


def test_what_is_read_is_what_was_sent(script, whole):
    """All that went out whole, which on a machine that leaves the reader waiting may be less than all."""
    sent, reader = whole
    commands_of, states_of = sent.index[sent.command_whole], sent.index[sent.state_whole]
    assert min(len(commands_of), len(states_of)) > 5
    states = XHAND.decode_states([frame.data for frame in reader.of("state")])
    commands = XHAND.decode_commands([frame.data for frame in reader.of("command")])
    np.testing.assert_array_equal(states.joint_position, script.joint_position[states_of])
    np.testing.assert_array_equal(states.force_counts, script.force_counts[states_of])
    np.testing.assert_array_equal(states.taxel_counts, script.taxel_counts[states_of])
    np.testing.assert_array_equal(commands.joint_target, script.joint_target[commands_of])
    assert [frame.kind for frame in reader.frames[:4]] == ["command", "state"] * 2


@pytest.mark.parametrize(("kind", "times"), [("state", "state_time_ns"), ("command", "command_time_ns")])
def test_stamps_are_the_times_of_the_first_bytes(whole, kind, times):
    """A busy machine makes a reader late, by nothing that a test could bound; it is never early."""
    sent, reader = whole
    read = np.array([frame.stamp_ns for frame in reader.of(kind)])
    # The two ends take the offset between the clocks at other moments: some microseconds.
    whole = getattr(sent, f"{kind}_whole")
    assert (read - getattr(sent, times)[whole]).min() > -20_000


class Clock:
    """A clock that only sleeping moves on, too far each time."""

    def __init__(self, late_ns: int):
        self.now, self.late_ns = 10**9, late_ns

    def monotonic_ns(self) -> int:
        return self.now

    def time_ns(self) -> int:
        return self.now + 10**18

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9) + self.late_ns


class Dead:
    """A line that takes all and keeps the moments."""

    link, received_bytes, port = None, 0, ""

    def __init__(self, clock: Clock):
        self.clock, self.written = clock, []

    def write(self, data: bytes) -> int:
        self.written.append((self.clock.now, len(data)))
        return len(data)

    def has_reader(self) -> bool:
        return True

    def close(self) -> None: ...
    def drain(self, limit_s: float) -> None: ...


def test_no_delay_adds_up(script, monkeypatch):
    """Each sleep ends 0.2 ms late; the thousandth row is no later than the first."""
    clock = Clock(200_000)
    monkeypatch.setattr(emulation, "time", clock)
    line = Dead(clock)
    sent = play(script, line, np.random.default_rng(0), passes=25)
    due = 10**18 + 10**9 + np.round(np.arange(1025) * 1e9 / RATE_HZ)
    # Sleeps are floats of seconds: 1 us of rounding.
    np.testing.assert_allclose(sent.command_time_ns - due, 200_000, atol=1000)
    wire_ns = (297 + 2217) * 10e9 / 3e6
    np.testing.assert_allclose(
        [at for at, size in line.written if size == 2217], due - 10**18 + wire_ns + 4e5, atol=2000
    )
    # The framer takes the wire's time off again: fed at the moment of writing, it stamps what was sent.
    framer = XHAND.framer()
    frames = [f for (at, _), data in zip(line.written, both(script), strict=False) for f in framer.feed(data, at)]
    stamps = np.array([frame.stamp_ns for frame in frames]) + 10**18
    np.testing.assert_array_equal(stamps[0::2], sent.command_time_ns[:41])
    np.testing.assert_array_equal(stamps[1::2], sent.state_time_ns[:41])


def both(script: Script) -> list[bytes]:
    """Requests and replies by turns."""
    return [frame for pair in zip(script.commands, script.states, strict=True) for frame in pair]


def test_what_is_late_is_followed_at_the_pace_of_the_wire(script, monkeypatch):
    """A machine that slept for a second sends the missed rows 8.38 ms apart, not at once."""
    clock = Clock(0)
    monkeypatch.setattr(emulation, "time", clock)
    line = Dead(clock)
    naps = iter([*[False] * 21, True])

    def stop() -> bool:
        if next(naps, False):
            clock.now += 10**9
        return False

    sent = play(script, line, np.random.default_rng(0), passes=6, stop=stop)
    steps = np.diff(sent.state_time_ns)
    assert steps.max() >= 10**9
    assert steps.min() == pytest.approx(8.38e6, rel=1e-3)
    assert sent.late_s == pytest.approx(1.0, abs=0.02)
    on_time = np.round(np.arange(len(sent.index)) * 1e9 / RATE_HZ)
    assert abs((sent.command_time_ns - sent.command_time_ns[0] - on_time)[-1]) < 1e9 - 0.6e6 * 200


def test_a_latency_timer_hands_over_what_came_at_its_beat(script, monkeypatch):
    """Rows of 9.1 ms behind a timer of 16 ms: nothing is lost or late on the wire, only read later, together."""
    clock = Clock(0)
    monkeypatch.setattr(emulation, "time", clock)
    line = Dead(clock)
    sent = play(script, line, np.random.default_rng(0), faults=parse_faults("burst:0.016"))
    at = np.array([at for at, _ in line.written])
    assert [size for _, size in line.written] == [len(frame) for frame in both(script)]
    # Sleeps are floats of seconds: 1 us of rounding.
    beat = (at - 10**9) / 16e6
    np.testing.assert_allclose(beat, np.round(beat), atol=1e-4)
    on_wire = np.column_stack([sent.command_time_ns, sent.state_time_ns]).ravel() - 10**18
    wire_ns = np.array([size for _, size in line.written]) * 10e9 / 3e6
    waited_ns = at - on_wire - wire_ns
    assert waited_ns.min() > -2000
    assert waited_ns.max() < 16e6 + 2000
    assert sent.report()["whole_states"] == len(script)
    assert sent.late_s == pytest.approx(0, abs=1e-5)


def test_what_an_adapter_holds_goes_with_it(script, monkeypatch):
    clock = Clock(0)
    monkeypatch.setattr(emulation, "time", clock)
    line = Dead(clock)
    sent = play(script, line, np.random.default_rng(0), faults=parse_faults("burst:0.1,unplug@0.15"))
    # Rows of the first tick were handed over, those since then were not.
    assert 0 < sent.state_whole.sum() < len(sent.index)
    assert sent.report()["dropped_frames"] == 2 * len(sent.index) - len(line.written)


def test_the_report_counts(script, whole):
    sent, reader = whole
    report = sent.report()
    assert (report["rows"], report["received_bytes"], report["faults"]) == (41, 0, {})
    assert report["whole_commands"] + report["whole_states"] == len(reader.frames) == 82 - report["dropped_frames"]
    assert report["clipped"] == {
        "force_counts": int(script.force_clipped.sum()),
        "taxel_counts": int(script.taxels_clipped.sum()),
    }
    assert report["clipped"]["force_counts"] > 0
    assert reader.bytes + report["dropped_bytes"] == 41 * ROW_BYTES


def sent_to_a_sleeper(script, monkeypatch, passes, wakes_at) -> tuple[dict, Reader]:
    """The report of an emulation whose reader begins to read at a call of `stop`: one or two come with a row."""
    calls, real = iter(range(10**6)), Line.drain
    monkeypatch.setattr(Line, "drain", lambda line, _limit_s: real(line, 30.0))  # as long as a busy machine needs
    with Line() as line:
        reader = Reader(line.port)

        def stop() -> bool:
            if next(calls) == wakes_at:
                reader.start()
            return False

        report = play(script, line, np.random.default_rng(0), passes=passes, stop=stop).report()
    reader.join(5)
    assert reader.bytes + report["dropped_bytes"] == passes * 41 * ROW_BYTES
    assert report["whole_commands"] + report["whole_states"] == len(reader.frames)
    return report, reader


def test_a_reader_that_is_late_by_less_than_a_serial_port_keeps_loses_nothing(script, monkeypatch):
    report, _ = sent_to_a_sleeper(script, monkeypatch, 1, 16)  # with the 8th to the 16th row: above 12 kB, below 77
    assert report["dropped_frames"] == 0


def test_a_reader_that_sleeps_loses_whole_rows_and_none_is_torn(script, monkeypatch):
    report, reader = sent_to_a_sleeper(script, monkeypatch, 3, 200)
    assert 40 < report["dropped_frames"] < 200
    assert len(reader.of("command")) == len(reader.of("state"))
    assert not any(reader.counts[kind] for kind in ("crc_failures", "garbage_bytes", "oversize"))


def test_without_a_reader_all_is_lost(script):
    with Line() as line:
        report = play(script, line, np.random.default_rng(0)).report()
    assert (report["whole_states"], report["dropped_bytes"]) == (0, 41 * ROW_BYTES)


def test_what_the_reader_writes_is_counted(script):
    with Line() as line:
        reader = Reader(line.port)
        os.write(reader.port_file, b"hello")
        reader.start()
        report = play(script, line, np.random.default_rng(0)).report()
    reader.join(5)
    assert report["received_bytes"] == 5


def test_every_undamaged_frame_is_found(script):
    sent, reader = heard(script, "bitflip:0.1,truncate:0.1,head:0.2,garbage:0.1", passes=3)
    faults = sent.counts["faults"]
    assert set(faults) == {"bitflip", "truncate", "head", "garbage"}
    damaged = faults["bitflip"] + faults["truncate"] + faults["garbage"]
    lost = sent.counts["dropped_frames"]  # a lost one may be a damaged one too
    assert 0 <= sent.command_whole.sum() + sent.state_whole.sum() - (2 * 3 * 41 - damaged - lost) <= min(lost, damaged)
    states = XHAND.decode_states([frame.data for frame in reader.of("state")])
    index = sent.index[sent.state_whole]
    np.testing.assert_array_equal(states.taxel_counts, script.taxel_counts[index])
    np.testing.assert_array_equal(states.joint_position, script.joint_position[index])
    assert len(reader.of("command")) == sent.command_whole.sum()


def test_all_garbage_gives_no_frame(script):
    sent, reader = heard(script, "garbage:1")
    assert not reader.frames
    assert reader.bytes + sent.counts["dropped_bytes"] == 41 * ROW_BYTES
    assert not sent.state_whole.any()


def test_a_stall_is_a_gap_in_time(script):
    sent, reader = heard(script, "stall:0.1@0.15")
    silent = ~sent.state_whole
    at_s = np.arange(len(script)) / RATE_HZ
    assert silent[(at_s >= 0.15) & (at_s < 0.25)].all()
    assert len(reader.of("state")) == sent.state_whole.sum() > 0
    stamps = np.array([frame.stamp_ns for frame in reader.of("state")])
    assert np.diff(stamps).max() > 0.05e9  # half of it, as the row before may have been late


def test_an_unplug_takes_the_port_away(script):
    sent, reader = heard(script, "unplug@0.2")
    assert len(sent.index) == 22  # rows at 0 .. 21 / 110 s
    assert not reader.is_alive()
    assert not os.path.exists(reader.port)


def test_a_replug_leads_the_link_to_a_new_port(script, tmp_path):
    link = tmp_path / "hand"
    later: list[Reader] = []

    def come_back(port: str) -> None:
        assert os.readlink(link) == port
        later.append(Reader(str(link)))
        later[0].start()

    with Line(link) as line:
        first = Reader(str(link))
        first.start()
        faults = parse_faults("unplug:0.1@0.1")
        sent = play(script, line, np.random.default_rng(0), faults=faults, on_port=come_back)
    first.join(5)
    later[0].join(5)
    assert not os.path.lexists(link)
    assert len(sent.index) == 41
    # 0.1 .. 0.2 s of 110 rows a second.
    assert not sent.state_whole[11:22].any()
    # What is on its way when the cable goes is lost with it; after it came back, nothing is.
    assert 0 < len(first.of("state")) <= sent.state_whole[:11].sum()
    assert len(later[0].of("state")) == sent.state_whole[22:].sum() > 0


def test_a_stop_ends_between_rows_and_a_hold_lasts_until_it(script):
    asked = iter(range(150))  # once or twice a row
    sent, reader = heard(script, hold=True, stop=lambda: next(asked, None) is None)
    assert len(sent.index) > 41
    assert set(sent.index[41:].tolist()) == {40}
    assert len(reader.of("state")) == sent.state_whole.sum()
    assert len(reader.of("command")) == sent.command_whole.sum()


def test_nothing_is_sent_after_a_stop_before_the_first_row(script):
    sent, reader = heard(script, stop=lambda: True)
    assert len(sent.index) == reader.bytes == 0
    assert sent.report()["seconds"] == 0.0


def test_the_wait_for_a_reader_ends_with_one_or_a_stop():
    with Line() as line:
        assert wait_for_reader(line, lambda: True) is False
        port = os.open(line.port, os.O_RDWR | os.O_NOCTTY)
        assert wait_for_reader(line, lambda: False) is True
        os.close(port)
        assert not line.has_reader()


def test_the_table_is_read_by_its_map(script, whole, tmp_path):
    sent, _reader = whole
    path = tmp_path / "poses" / "poses.parquet"
    files.check_table(path, script)
    files.write_table(path, sent)
    (episode,) = table.read(path.with_name("map.yaml"))
    # A second since 1970 in float64 is good to 0.24 us.
    np.testing.assert_allclose(episode["time_ns"], sent.state_time_ns, rtol=0, atol=300)
    np.testing.assert_array_equal(episode["object_pose"], script.unwired_channels["object_pose"].astype(np.float32))
    np.testing.assert_array_equal(
        episode["joint_position"], script.unwired_channels["joint_position"].astype(np.float32)
    )
    np.testing.assert_array_equal(episode["action"], script.unwired_channels["action"].astype(np.float32))
    meta = episode.meta
    assert (meta.task, meta.scene, meta.object, meta.rate_hz) == ("push", "xhand_tabletop", "object", RATE_HZ)
    assert (meta.joint_names, meta.actuator_names) == (("wrist_x",), ("wrist_x",))
    stored = EpisodeMeta.model_validate_json(pq.read_schema(path).metadata[files.META_KEY])
    assert stored == script.meta
    assert yaml.safe_load(path.with_name("map.yaml").read_text())["file"] == "poses.parquet"
    with pytest.raises(UsageError, match="the output exists already"):
        files.check_table(path, script)
    with pytest.raises(UsageError, match="the output exists already"):
        files.check_table(path.with_name("other.parquet"), script)


def test_a_table_of_another_kind_is_refused(script, tmp_path):
    with pytest.raises(UsageError, match="the table is a Parquet file"):
        files.check_table(tmp_path / "poses.csv", script)


def test_a_table_that_cannot_be_written_is_said(whole, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SetupError, match="the table cannot be written"):
        files.write_table(tmp_path / "file" / "poses.parquet", whole[0])
    with pytest.raises(SetupError, match="the truth cannot be written"):
        files.write_truth(tmp_path / "file" / "truth.npz", whole[0])
    with pytest.raises(SetupError, match="the file cannot be written"):
        files.prepare(tmp_path / "file" / "truth.npz")


def test_the_truth_holds_what_was_sent(script, whole, tmp_path):
    sent, _reader = whole
    files.write_truth(tmp_path / "truth.npz", sent)
    with np.load(tmp_path / "truth.npz", allow_pickle=False) as truth:
        np.testing.assert_array_equal(truth["joint_target"], script.joint_target)
        np.testing.assert_array_equal(truth["taxel_counts"], script.taxel_counts)
        np.testing.assert_array_equal(truth["state_time_ns"], sent.state_time_ns)
        np.testing.assert_array_equal(truth["unwired_joint_position"], script.unwired_channels["joint_position"])
        assert truth["still"].sum() == script.rest_rows == 11
        assert truth["joint_names"].tolist() == list(XHAND.joint_names)
        assert EpisodeMeta.model_validate_json(str(truth["meta"])) == script.meta
