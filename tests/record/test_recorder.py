"""The recorder on a pseudo-terminal: nothing lost, nothing written, every failure ends in a whole file."""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from candata import plugins
from candata.errors import SetupError, UsageError
from candata.formats._mcap_scan import Scan
from candata.record.devices import _xhand_frames as wire
from candata.record.emulate import play
from candata.record.emulate_faults import parse_faults
from candata.record.emulate_line import Line
from candata.record.emulate_script import write_script
from candata.record.import_recipe import ImportRecipe
from candata.record.importing import import_log
from candata.record.logs import read_log
from candata.record.recorder import record
from candata.record.recorder_values import RecorderSettings
from candata.schema.episode import Episode, EpisodeMeta

DEVICE = plugins.load("candata.record.devices", "DEVICE", "xhand")


class Watcher:
    """Keeps what a recording shows and says, and does something once `when(view)` holds."""

    def __init__(self, when=lambda view: False, act=lambda: None):
        self.views, self.notes = [], []
        self._when, self._act = when, act

    def show(self, view):
        self.views.append(view)
        if self._when(view):
            self._when = lambda view: False
            self._act()


def run(port, out, watcher=None, device=DEVICE, stop=lambda: False, overrides=None, **settings):
    watcher = watcher or Watcher()
    chosen = RecorderSettings(**{"calibrate_s": 0.0, "reserve_bytes": 0, **settings})
    report = record(
        device,
        port,
        out,
        name="xhand",
        settings=chosen,
        overrides=overrides,
        stop=stop,
        show=watcher.show,
        say=watcher.notes.append,
    )
    return report, watcher


def wire_bytes(path) -> bytes:
    from mcap.records import Channel, Message

    from candata.formats._mcap_messages import message

    topics, data = {}, b""
    for item in Scan(path):
        if isinstance(item, Channel):
            topics[item.id] = item.topic
        elif isinstance(item, Message) and topics[item.channel_id] == "/wire":
            data += message("candata.WireBytes").FromString(item.data).data
    return data


def test_what_was_sent_stands_in_the_log(hand, tmp_path, rng):
    position = rng.normal(size=(40, 12)).astype(np.float32)
    force = rng.integers(0, 50, (40, 5, 3))
    one = hand(position=position, force=force)
    report, watcher = run(one.port, tmp_path / "log.mcap", duration_s=0.8)
    log = read_log(tmp_path / "log.mcap")
    assert report.failure is None
    assert not log.torn
    rows = len(log.joint_position)
    first = int(np.flatnonzero((position == log.joint_position[0]).all(axis=1))[0])
    order = (first + np.arange(rows)) % 40
    np.testing.assert_array_equal(log.joint_position, position[order])
    np.testing.assert_array_equal(log.force_counts, force[order])
    np.testing.assert_array_equal(log.joint_target[: rows - 1], position[order[: rows - 1]])
    assert report.facts["rows"] == rows
    assert report.facts["ended"] == "duration"
    assert report.facts["sha256"] == log.sha256
    assert abs(time.time_ns() - log.state_time_ns[-1]) < 60e9
    assert watcher.views[-1].phase == "recording"
    assert any("no low latency mode" in note for note in watcher.notes)


def test_a_decoder_that_disagrees_with_its_taxels_is_said_and_the_log_can_be_read(hand, tmp_path):
    report, _ = run(hand().port, tmp_path / "log.mcap", device=replace(DEVICE, taxels=60), duration_s=0.5)
    words = str(report.failure)
    assert "the device's decoder disagrees with what the device declares" in words
    assert "expected: taxel_counts (1, 5, 60, 3)" in words
    assert "found: (1, 5, 120, 3)" in words
    assert len(read_log(tmp_path / "log.mcap").state_time_ns) == 0
    assert wire_bytes(tmp_path / "log.mcap")


def test_every_byte_of_the_wire_stands_in_the_log(hand, tmp_path):
    one = hand()
    run(one.port, tmp_path / "log.mcap", duration_s=0.6)
    data = wire_bytes(tmp_path / "log.mcap")
    assert len(data) > 30_000
    assert data in one.wrote


def test_a_recorder_that_stands_still_loses_nothing(hand, tmp_path):
    one = hand(drops=True)
    watcher = Watcher(when=lambda view: view.frames["state"] > 20, act=lambda: time.sleep(1.0))
    report, _ = run(one.port, tmp_path / "log.mcap", watcher, duration_s=1.8)
    # Four frames fill the buffer: a reader that stood still too would have dropped about 79 of the 83.
    assert one.dropped < 20
    assert report.facts["rows"] > 100
    log = read_log(tmp_path / "log.mcap")
    # The stamps are those of the reader, not of the recorder that came back after a second.
    assert np.diff(log.state_time_ns).max() < 0.5e9


def test_not_one_byte_is_written_to_the_port(hand, tmp_path):
    one = hand()
    run(one.port, tmp_path / "log.mcap", duration_s=0.5)
    assert one.heard() == b""
    # The check can fail: what the slave's side writes is heard.
    os.write(one._slave, b"x")
    assert one.heard() == b"x"


def test_a_resting_hand_is_calibrated(hand, tmp_path):
    force = np.tile([1, -2, 3], (40, 5, 1))
    one = hand(force=force)
    report, watcher = run(one.port, tmp_path / "log.mcap", duration_s=0.5, calibrate_s=0.5)
    found = read_log(tmp_path / "log.mcap").calibration
    np.testing.assert_array_equal(found.force_bias_counts, force[0])
    assert report.facts["calibrated"]
    assert watcher.views[0].phase in ("waiting", "calibrating")
    np.testing.assert_array_equal(watcher.views[-1].force_N, 0.0)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ({"position": np.linspace(0, 1, 40)[:, None] * np.eye(12)[4]}, "found: index1 [01].* rad"),
        ({"force": np.arange(40)[:, None, None] * np.ones((5, 3), int) * (np.arange(5) == 2)[:, None]}, "mid2 changed"),
    ],
)
def test_a_hand_that_moves_or_is_touched_ends_the_recording(hand, tmp_path, rows, words):
    one = hand(**rows)
    report, _ = run(one.port, tmp_path / "log.mcap", duration_s=5.0, calibrate_s=0.5)
    assert isinstance(report.failure, SetupError)
    with pytest.raises(SetupError, match=words):
        raise report.failure
    log = read_log(tmp_path / "log.mcap")
    assert not log.torn
    assert len(log.joint_position) > 20
    assert log.calibration is None


def test_the_statistics_count_gaps_losses_and_missing_replies(hand, tmp_path):
    good = hand().frames
    request = good[0][:297]
    broken = good[0][:-1] + bytes([good[0][-1] ^ 1])
    # Per 24 periods: one without a reply (then two requests in a row), one broken reply; the rest is good.
    one = hand(frames=[*good[:10], request, *good[:10], broken, good[0], good[0]])
    report, _ = run(one.port, tmp_path / "log.mcap", duration_s=2.2)
    facts = report.facts
    periods = facts["commands"] / 24
    assert periods > 4
    for kind, per_period in (("crc_failures", 1), ("requests_without_reply", 2)):
        # The recording begins and ends within a period.
        assert per_period * (periods - 1.5) <= facts["losses"][kind] <= per_period * (periods + 1.5)
    # A busy machine that sends late adds gaps of its own.
    assert facts["gaps"] >= 2 * (periods - 1.5)
    statistics = read_log(tmp_path / "log.mcap").statistics
    assert len(statistics) >= 3
    assert statistics[-1]["losses"] == facts["losses"]
    wall_less_monotonic = [s["clock"]["wall_ns"] - s["clock"]["monotonic_ns"] for s in statistics]
    # Both clocks are read one after the other: they agree to a scheduler's delay.
    assert np.ptp(wall_less_monotonic) < 50e6


def test_saturated_readings_are_counted_and_rest_is_not(hand, tmp_path):
    force = np.zeros((40, 5, 3), int)
    force[::2, 1] = (0, 0, 255)
    force[::2, 3] = (-128, 0, 0)
    one = hand(force=force)
    report, _ = run(one.port, tmp_path / "log.mcap", duration_s=0.5)
    # Every other row has two saturated fingertips: as many as rows, give or take the last one.
    assert abs(report.facts["saturated"]["forces"] - report.facts["rows"]) <= 1
    assert report.facts["saturated"]["taxels"] == 0


def test_unplug_and_replug_go_on_in_the_same_file(hand, tmp_path):
    one = hand()
    done = []

    def replug():
        one.unplug()
        done.append(time.monotonic() + 1.5)

    watcher = Watcher(when=lambda view: view.frames["state"] > 30, act=replug)
    plugged = []

    def stop():
        if done and not plugged and time.monotonic() > done[0] - 1.0:
            one.plug()
            plugged.append(len(watcher.views))
        return bool(done) and time.monotonic() > done[0]

    report, _ = run(one.port, tmp_path / "log.mcap", watcher, stop=stop)
    assert report.failure is None
    (unplug,) = report.facts["unplugs"]
    # The port is away for half a second, and asked for every tenth.
    assert 0.4e9 < unplug["back_ns"] - unplug["lost_ns"] < 1.5e9
    assert any("waiting 10 s" in note for note in watcher.notes)
    assert any("the port is back" in note for note in watcher.notes)
    assert "unplugged" in {view.phase for view in watcher.views}
    log = read_log(tmp_path / "log.mcap")
    assert np.diff(log.state_time_ns).max() > 0.4e9
    assert (log.state_time_ns > unplug["back_ns"]).sum() > 10
    assert log.statistics[-1]["unplugs"] == [unplug]


def test_a_hand_unplugged_while_it_is_calibrated_is_imported_from_the_new_calibration_on(hand, tmp_path):
    one, path = hand(), tmp_path / "log.mcap"

    def replug():
        one.unplug()
        one.plug()

    watcher = Watcher(when=lambda view: view.frames["state"] > 15, act=replug)
    report, _ = run(one.port, path, watcher, calibrate_s=0.4, duration_s=0.4)
    assert len(report.facts["unplugs"]) == 1
    log = read_log(path)
    assert log.calibration.end_ns > report.facts["unplugs"][0]["back_ns"] + 0.35e9
    episode = import_log(path, log, ImportRecipe(episode="run")).episode
    assert episode["time_ns"][0] >= log.calibration.end_ns


def test_a_port_that_stays_away_ends_in_a_whole_file(hand, tmp_path):
    one = hand()
    watcher = Watcher(when=lambda view: view.frames["state"] > 30, act=one.unplug)
    report, _ = run(one.port, tmp_path / "log.mcap", watcher, reconnect_s=0.3)
    assert report.failure.exit_code == 3
    assert report.failure.problem == "the port is gone"
    log = read_log(tmp_path / "log.mcap")
    assert not log.torn
    assert len(log.joint_position) > 30


def test_garbage_is_called_a_wrong_baud_rate_after_two_seconds(hand, tmp_path, rng):
    one = hand(frames=[rng.bytes(200) for _ in range(50)])
    report, watcher = run(one.port, tmp_path / "log.mcap", duration_s=30.0)
    assert report.failure.exit_code == 3
    assert "the baud rate is wrong" in report.failure.problem
    # Said after 2 s and not at once: the last view is up to 0.1 s older, or more where the machine is busy.
    assert 1.5 < watcher.views[-1].elapsed_s < 6.0
    assert len(wire_bytes(tmp_path / "log.mcap")) > 10_000


def test_a_silent_port_is_said_and_waited_for(hand, tmp_path):
    one = hand(silent=True)
    report, watcher = run(one.port, tmp_path / "log.mcap", duration_s=1.5, patience_s=0.3)
    assert [note for note in watcher.notes if "no bytes for 0.3 s" in note] == [watcher.notes[-1]]
    assert report.failure.problem == "the port gave no byte"
    assert not read_log(tmp_path / "log.mcap").torn


def test_the_duration_counts_from_the_calibration(hand, tmp_path):
    one = hand(silent=True)
    # Silent for longer than the recording would last if it counted from the opening of the port.
    late = Watcher(lambda view: True, threading.Timer(0.7, one.speak).start)
    report, _ = run(one.port, tmp_path / "log.mcap", late, duration_s=0.5, calibrate_s=0.5)
    assert report.failure is None
    assert report.facts["calibrated"]
    # A second of states; a busy machine may drop the last.
    assert 0.7 < report.facts["duration_s"] < 1.1


def test_a_glitch_before_the_first_frame_ends_nothing(hand, tmp_path):
    one = hand(silent=True)

    def glitch():
        os.write(one.master, b"\x00\xff\x80")
        threading.Timer(1.3, one.speak).start()

    report, _ = run(one.port, tmp_path / "log.mcap", Watcher(lambda view: True, glitch), duration_s=2.0, patience_s=0.3)
    assert report.failure is None
    assert report.facts["rows"] > 0
    assert report.facts["losses"]["garbage_bytes"] == 3


def test_a_frame_that_the_end_cuts_is_no_loss(hand, tmp_path):
    one = hand(silent=True)
    whole = one.frames[0]

    def begin():
        os.write(one.master, whole + whole[: len(whole) // 2])

    report, _ = run(one.port, tmp_path / "log.mcap", Watcher(lambda view: True, begin), duration_s=1.0)
    assert report.facts["rows"] == 1
    assert report.facts["losses"]["garbage_bytes"] == 0


@pytest.mark.parametrize("rate_hz", [50.0, 83.0])
def test_bursts_of_an_adapter_are_told_with_the_remedy_while_they_last_and_in_the_end(tmp_path, rate_hz):
    report, watcher, log = recorded_from(tmp_path, rate_hz, "burst:0.016")
    remedy = "/sys/bus/usb-serial/devices/ttyUSB0/latency_timer (as root), or setserial /dev/ttyUSB0 low_latency"
    (note,) = [note for note in watcher.notes if "in bursts" in note]
    assert note.startswith("bytes come in bursts, every 16 ms, as a USB adapter's latency timer makes them: stamps are")
    assert remedy in note
    assert remedy in report.facts["bursts"]
    found = import_log(log, read_log(log), ImportRecipe(episode="run", rate_hz=rate_hz, uncalibrated=True))
    (told,) = [note for note in found.notes if "in bursts" in note]
    assert "stamps are up to 16 ms late, half of that in the mean; do: echo 1 > " in told
    assert not any("read late in a burst after a gap" in note for note in found.notes)


def test_a_healthy_port_has_no_bursts(tmp_path):
    report, watcher, log = recorded_from(tmp_path, 83.0, "")
    assert report.facts["bursts"] is None
    assert not any("bursts" in note for note in watcher.notes)
    found = import_log(log, read_log(log), ImportRecipe(episode="run", uncalibrated=True))
    assert not any("bursts" in note for note in found.notes)


def recorded_from(folder, rate_hz: float, faults: str):
    """Five seconds of a resting emulated hand: the report, what was shown and said, and the log."""
    rows = np.zeros((8, 12))
    joints, tips = DEVICE.joint_names, DEVICE.fingertip_names
    names = {"joint_names": joints, "actuator_names": joints, "fingertip_names": tips}
    meta = EpisodeMeta.model_validate({"id": "e", "source": "sim", "rate_hz": rate_hz, **names})
    arrays = {"joint_position": rows, "action": rows, "fingertip_force": np.zeros((8, 5, 3))}
    arrays["time_ns"] = np.arange(8) * round(1e9 / rate_hz)
    script = write_script(Episode(meta, arrays), "xhand", DEVICE, rate_hz=rate_hz, still_s=0.0)
    stop = threading.Event()
    with Line(folder / "port") as line:
        rng = np.random.default_rng(0)
        asked = {"faults": parse_faults(faults), "passes": 0, "stop": stop.is_set}
        sender = threading.Thread(target=play, args=(script, line, rng), kwargs=asked)
        sender.start()
        log = folder / "log.mcap"
        report, watcher = run(str(folder / "port"), log, duration_s=5.0)
        stop.set()
        sender.join()
    return report, watcher, log


def test_a_hand_that_never_replies_is_said(hand, tmp_path):
    one = hand(frames=wire.command_frames(np.zeros((40, 12))))
    report, _ = run(one.port, tmp_path / "log.mcap", duration_s=0.5)
    assert report.failure.problem == "the hand gave no state"
    assert re.fullmatch(r"\d+ requests without a reply", report.failure.found)


def test_bytes_that_turn_bad_are_said_once_and_recorded_on(hand, tmp_path, rng):
    one = hand()
    noise = [rng.bytes(200) for _ in one.frames]
    watcher = Watcher(lambda view: view.frames["state"] > 10, lambda: setattr(one, "frames", noise))
    report, _ = run(one.port, tmp_path / "log.mcap", watcher, duration_s=2.5, patience_s=0.3)
    assert report.failure is None
    assert len([note for note in watcher.notes if "bytes but no good frame for 0.3 s" in note]) == 1


def test_a_missing_port_leaves_no_file(tmp_path):
    with pytest.raises(SetupError, match=r"no such port\n  found: .*port") as caught:
        run(str(tmp_path / "nowhere"), tmp_path / "log.mcap")
    assert caught.value.exit_code == 3
    assert not (tmp_path / "log.mcap").exists()


def test_what_is_no_port_leaves_no_file(tmp_path):
    (tmp_path / "file").write_text("mine")
    for port in (tmp_path / "file", tmp_path):
        with pytest.raises(SetupError, match="not a serial port"):
            run(str(port), tmp_path / "log.mcap")
    assert (tmp_path / "file").read_text() == "mine"
    assert not (tmp_path / "log.mcap").exists()


def test_a_port_that_another_recorder_holds_is_refused(hand, tmp_path):
    one = hand()
    second = []

    def again():
        with pytest.raises(SetupError, match="the port cannot be opened") as caught:
            run(one.port, tmp_path / "second.mcap", duration_s=1.0)
        second.append(caught.value)

    run(one.port, tmp_path / "log.mcap", Watcher(lambda view: True, again), duration_s=0.5)
    assert second
    assert not (tmp_path / "second.mcap").exists()


def test_no_permission_says_which_group(monkeypatch, hand, tmp_path):
    one = hand()
    monkeypatch.setattr(os, "access", lambda *_: False)  # the suite may run as root, whom no mode stops
    with pytest.raises(SetupError, match=r"no permission for the port[^$]*dialout"):
        run(one.port, tmp_path / "log.mcap")


def test_a_standing_file_is_refused_before_the_port_is_touched(tmp_path):
    (tmp_path / "log.mcap").write_text("mine")
    with pytest.raises(UsageError, match="exists already"):
        run(str(tmp_path / "nowhere"), tmp_path / "log.mcap")
    assert (tmp_path / "log.mcap").read_text() == "mine"


def test_a_disk_below_the_reserve_is_refused(hand, tmp_path):
    with pytest.raises(SetupError, match=r"nearly full[^$]*--reserve-mb"):
        run(hand().port, tmp_path / "log.mcap", reserve_bytes=10**18)
    assert not (tmp_path / "log.mcap").exists()


def test_a_disk_that_fills_up_keeps_what_was_committed(hand, tmp_path, rng):
    import resource

    # Random readings, which no compression shrinks: the limit comes within a second.
    one = hand(position=rng.normal(size=(40, 12)), force=rng.integers(0, 100, (40, 5, 3)))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, before[1]))
    try:
        report, _ = run(one.port, tmp_path / "log.mcap", duration_s=20.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert report.failure.exit_code == 3
    assert report.failure.problem == "the log cannot be written"
    log = read_log(tmp_path / "log.mcap")
    assert 0 < len(log.joint_position) <= report.facts["rows"]


def test_a_reader_that_dies_ends_in_a_whole_file(hand, tmp_path, monkeypatch):
    from candata.record import recorder

    links = []

    class Kept(recorder.ReaderLink):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            links.append(self)

    monkeypatch.setattr(recorder, "ReaderLink", Kept)
    watcher = Watcher(lambda view: view.frames["state"] > 30, lambda: os.kill(links[0].pid, signal.SIGKILL))
    report, _ = run(hand().port, tmp_path / "log.mcap", watcher, duration_s=20.0)
    assert report.failure.problem == "the reader process died"
    log = read_log(tmp_path / "log.mcap")
    assert not log.torn
    assert len(log.joint_position) > 30
