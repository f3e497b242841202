"""Streams beside the hand: one log holds what each sent, and every failure is one error or one note."""

from __future__ import annotations

import socket
import time

import numpy as np
import pytest

from candata import plugins
from candata.errors import DataError, SetupError, UnknownNameError, UsageError
from candata.record.addresses import Address, StreamSource, parse_stream
from candata.record.devices import stream
from candata.record.logs import read_log
from candata.record.recorder import record
from candata.record.recorder_values import RecorderSettings
from candata.record.replay import hand_source
from tests.record.streams import ARM, POSE, LineServer, free_port, line, source, udp_sender

DEVICE = plugins.load("candata.record.devices", "DEVICE", "xhand")


def run(port, out, *sources, notes=None, show=lambda view: None, **settings):
    chosen = RecorderSettings(**{"calibrate_s": 0.0, "reserve_bytes": 0, "patience_s": 0.5, **settings})
    return record(
        DEVICE,
        port,
        out,
        name="xhand",
        settings=chosen,
        streams=sources,
        show=show,
        say=[].append if notes is None else notes.append,
    )


def arm_line(number: int) -> bytes:
    return line(number, [0.001 * number, 1.0, 0.001 * number + 0.5, 1.5])


def pose_line(number: int) -> bytes:
    return line(number, [0.01 * number, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def arm():
    server = LineServer(200.0, arm_line)
    yield server
    server.close()


def test_every_stream_stands_in_the_log_as_it_was_sent(hand, arm, tmp_path):
    port, views, heard = free_port(), [], []

    def show(view):
        views.append(view)
        heard.append(arm.heard())

    arm_source, pose_source = source("arm", ARM, f"127.0.0.1:{arm.port}"), source("pose", POSE, f"127.0.0.1:{port}")
    one = hand()
    with udp_sender(port, 15.0, pose_line):
        report = run(one.port, tmp_path / "l.mcap", arm_source, pose_source, duration_s=1.2, show=show)
    assert report.failure is None
    log = read_log(tmp_path / "l.mcap")
    streams = {stream.meta.name: stream for stream in log.streams}
    assert list(streams) == ["arm", "pose"]
    arm_rows = streams["arm"]
    numbers = np.round(arm_rows.values["joint_position"][:, 0] * 1000).astype(int)
    np.testing.assert_array_equal(numbers, np.arange(numbers[0], numbers[0] + len(numbers)))
    np.testing.assert_allclose(arm_rows.values["joint_target"], arm_rows.values["joint_position"] + 0.5)
    np.testing.assert_array_equal(arm_rows.device_time_ns, numbers * 1_000_000)
    assert streams["arm"].meta.signals[1].names == ("w0", "w1")
    assert len(numbers) > 150
    np.testing.assert_allclose(
        streams["pose"].values["object_pose"][:, 3:], [[1, 0, 0, 0]] * len(streams["pose"].time_ns)
    )
    assert log.state_time_ns[0] - 5e8 < arm_rows.time_ns[0] < arm_rows.time_ns[-1] < log.state_time_ns[-1] + 5e8
    facts = report.facts["streams"]["arm"]
    assert facts["frames"] == len(numbers)
    assert facts["losses"] == {"malformed": 0}
    assert [view.name for view in views[-1].streams] == ["arm", "pose"]
    assert views[-1].streams[0].phase == "recording"
    assert one.heard() == b""
    assert not any(heard)


def test_a_full_disk_ends_it_with_one_error_and_a_log_that_can_be_read(hand, arm, tmp_path, file_limit):
    report = run(hand().port, tmp_path / "l.mcap", source("arm", ARM, f"127.0.0.1:{arm.port}"), duration_s=20)
    assert "the log cannot be written" in str(report.failure)
    log = read_log(tmp_path / "l.mcap")
    assert len(log.state_time_ns) > 0
    assert len(log.streams[0].time_ns) > 0


def test_a_stream_that_was_never_heard_is_one_error(hand, tmp_path):
    silent = source("pose", POSE, f"127.0.0.1:{free_port()}")
    report = run(hand().port, tmp_path / "l.mcap", silent, duration_s=20)
    assert "the stream pose was never heard" in str(report.failure)
    assert silent.address.place in str(report.failure)
    assert report.facts["duration_s"] < 5


def test_bytes_that_are_no_frames_name_what_was_met(hand, tmp_path):
    port = free_port()
    with udp_sender(port, 50.0, lambda number: b"v2 1 2 3\n"):
        report = run(hand().port, tmp_path / "l.mcap", source("pose", POSE, f"127.0.0.1:{port}"), duration_s=20)
    assert "gives bytes but no good frame" in str(report.failure)
    assert "malformed" in str(report.failure)


def test_a_stream_that_falls_silent_is_noted_and_the_hand_goes_on(hand, tmp_path):
    port, notes, views = free_port(), [], []

    def is_silent():
        return views and views[-1].streams[0].frames > 2

    with udp_sender(port, 15.0, lambda number: b"" if is_silent() else pose_line(number)):
        report = run(
            hand().port,
            tmp_path / "l.mcap",
            source("pose", POSE, f"127.0.0.1:{port}"),
            duration_s=2.2,
            notes=notes,
            show=views.append,
        )
    assert report.failure is None
    assert any(note.startswith("pose: no good frame for") for note in notes)
    assert views[-1].streams[0].phase == "silent"
    assert report.facts["streams"]["pose"]["silent_s"] > 1.0


def test_a_connection_that_drops_is_taken_up_again(hand, arm, tmp_path):
    notes, drops = [], []

    def show(view):
        if view.streams[0].frames > 60 and not drops:
            drops.append(arm.drop())

    report = run(
        hand().port,
        tmp_path / "l.mcap",
        source("arm", ARM, f"127.0.0.1:{arm.port}"),
        duration_s=1.5,
        notes=notes,
        show=show,
    )
    assert report.failure is None
    assert report.facts["streams"]["arm"]["unplugs"] == 1
    assert report.facts["streams"]["arm"]["gaps"] >= 1
    assert "arm: it is back; the recording goes on" in notes
    assert read_log(tmp_path / "l.mcap").streams[0].values["joint_position"][-1, 0] < 0.001 * 300


def test_a_clock_that_steps_back_is_told_and_kept(hand, tmp_path):
    port, notes = free_port(), []
    with udp_sender(port, 15.0, lambda number: pose_line(number % 5)):
        report = run(
            hand().port, tmp_path / "l.mcap", source("pose", POSE, f"127.0.0.1:{port}"), duration_s=1.0, notes=notes
        )
    assert any("its clock stepped back by 0.004 s" in note for note in notes)
    clock = read_log(tmp_path / "l.mcap").streams[0].device_time_ns
    assert report.facts["streams"]["pose"]["clock_steps_back"] == (np.diff(clock) < 0).sum() > 0


def test_an_address_that_nothing_serves_or_another_holds_is_refused(hand, tmp_path):
    one = hand()
    with pytest.raises(SetupError, match=r"nothing serves this address[^$]*tcp://127.0.0.1"):
        run(one.port, tmp_path / "l.mcap", source("arm", ARM, f"127.0.0.1:{free_port(socket.SOCK_STREAM)}"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        with pytest.raises(SetupError, match=r"taken by another program[^$]*udp://127.0.0.1"):
            run(one.port, tmp_path / "l.mcap", source("pose", POSE, f"127.0.0.1:{holder.getsockname()[1]}"))
    with pytest.raises(SetupError, match="this machine has no such address"):
        run(one.port, tmp_path / "l.mcap", source("pose", POSE, "203.0.113.7:4000"))
    assert not (tmp_path / "l.mcap").exists()


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("arm", UsageError, "NAME=DEVICE@ADDRESS"),
        ("hand=xhand@/dev/x", UsageError, "is no name for a stream"),
        ("Arm=xhand@/dev/x", UsageError, "is no name for a stream"),
        ("arm=xhand@/dev/x", UsageError, "is a hand, not a stream"),
        ("arm=toaster@/dev/x", UnknownNameError, "toaster"),
    ],
)
def test_a_stream_that_is_named_wrongly_is_refused(text, error, words):
    with pytest.raises(error, match=words):
        parse_stream(text)


def test_two_streams_of_one_name_or_address_are_refused(hand, tmp_path):
    first, second = (source(name, POSE, "127.0.0.1:4000") for name in ("pose", "other"))
    with pytest.raises(UsageError, match="two streams have one address"):
        run(hand().port, tmp_path / "l.mcap", first, second)
    with pytest.raises(UsageError, match="two streams are called pose"):
        run("port", tmp_path / "l.mcap", first, source("pose", POSE, "127.0.0.1:4001"))


def test_a_network_address_knows_host_and_port():
    assert (Address("udp", "[::1]:4000").host, Address("udp", "[::1]:4000").number) == ("::1", 4000)


def test_a_poll_repeats_the_set_point_and_logs_it(hand, tmp_path):
    posture = (0.1,) * 3 + (0.0,) + (0.2,) * 8
    one = hand()
    report = run(one.port, tmp_path / "l.mcap", duration_s=0.6, poll_rad=posture)
    time.sleep(0.05)
    command = DEVICE.encoder.command_frames(np.array([posture]))[0]
    assert one.heard()[: len(command)] == command
    assert report.facts["polled"]
    targets = read_log(tmp_path / "l.mcap").joint_target
    assert 20 < len(targets) < 80
    np.testing.assert_allclose(targets, np.tile(posture, (len(targets), 1)), atol=1e-6)


def test_a_set_point_beyond_a_limit_is_never_written(hand, tmp_path):
    one = hand()
    with pytest.raises(UsageError, match=r"leaves the limits of index_bend[^$]*-0.174 .. 0.174 rad"):
        run(one.port, tmp_path / "l.mcap", poll_rad=(0.1,) * 3 + (0.5,) + (0.2,) * 8)
    assert one.heard() == b""


def test_a_log_is_played_as_if_it_were_a_port(hand, tmp_path, rng):
    force = rng.integers(0, 50, (40, 5, 3))
    run(hand(force=force).port, tmp_path / "a.mcap", duration_s=0.6)
    played = hand_source("replay", str(tmp_path / "a.mcap"))
    report = record(
        played.device,
        played.port,
        tmp_path / "b.mcap",
        name=played.name,
        settings=RecorderSettings(calibrate_s=0.0, reserve_bytes=0, patience_s=5.0),
        overrides=played.settings,
    )
    assert report.failure is None
    assert report.facts["ended"] == "replayed"
    first, second = read_log(tmp_path / "a.mcap"), read_log(tmp_path / "b.mcap")
    np.testing.assert_array_equal(first.force_counts, second.force_counts)
    np.testing.assert_array_equal(np.diff(first.state_time_ns), np.diff(second.state_time_ns))
    with pytest.raises(DataError, match="no such log"):
        hand_source("replay", str(tmp_path / "none.mcap"))


def test_a_stream_that_describes_itself_is_logged_under_its_own_names(hand, tmp_path):
    cobs = stream("cobs")
    values = {"device_time": np.arange(40) * 10_000_000, "wrench": np.arange(240.0).reshape(40, 6)}
    port = hand(frames=cobs.encode(values)).port
    address = Address("serial", port, cobs.baud)
    report = run(hand().port, tmp_path / "l.mcap", StreamSource("glove", "cobs", cobs, address), duration_s=1.2)
    assert report.failure is None
    rows = read_log(tmp_path / "l.mcap").streams[0]
    assert [signal.name for signal in rows.meta.signals] == ["device_time", "wrench"]
    row = int(rows.values["wrench"][0, 0]) // 6
    order = (row + np.arange(len(rows.time_ns))) % 40
    np.testing.assert_allclose(rows.values["wrench"], values["wrench"][order])
    np.testing.assert_array_equal(rows.device_time_ns, values["device_time"][order])
