"""`record-real` and `recover` as their user meets them: exit codes, reports, signals."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tty

import numpy as np
import pytest

from candata.record.devices import _xhand_frames as wire
from candata.record.logs import read_log
from candata_cli import main as entry


@pytest.fixture
def port(tmp_path):
    """A pseudo-terminal on which a resting hand is asked and answers at 83 Hz."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    frame = wire.command_frames(np.zeros((1, 12)))[0]
    frame += wire.state_frames(np.zeros((1, 12)), np.full((1, 5, 3), 2), np.zeros((1, 5, 120, 3), int))[0]
    stop = threading.Event()

    def send():
        while not stop.wait(1 / 83):
            try:
                os.write(master, frame)
            except BlockingIOError:
                continue

    thread = threading.Thread(target=send)
    thread.start()
    yield os.ttyname(slave)
    stop.set()
    thread.join()
    os.close(master)
    os.close(slave)


def start(*arguments) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "candata_cli.main", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )


@pytest.fixture
def candata(capsys):
    """Runs a command in this process: exit code, stdout, stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            entry.main([str(a) for a in arguments])
        return stop.value.code or 0, *capsys.readouterr()

    return run


def test_a_recording_reports_and_exits_with_0(port, tmp_path, candata):
    log = tmp_path / "log.mcap"
    code, out, err = candata(
        "record-real", "--port", port, "--out", log, "--duration", 1.2, "--calibrate-s", 0.5, "--reserve-mb", 0
    )
    assert code == 0, err
    lines = dict(line.split(maxsplit=1) for line in out.splitlines())
    read = read_log(log)
    assert lines["states"].startswith(f"{len(read.joint_position)} in ")
    # On a busy machine the recorder may begin within a frame.
    assert re.fullmatch(r"nothing|\d{1,4} garbage bytes", lines["lost"])
    assert lines["calibrated"] == "yes"
    assert lines["ended"] == "duration"
    assert lines["sha256"] == read.sha256
    assert "calibrated over" in err
    # No terminal, so a line a second instead of the panel.
    assert "0:00:01 recording: " in err
    assert "\x1b" not in out + err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_finishes_the_file_and_prints_the_report(port, tmp_path, number):
    log = tmp_path / "log.mcap"
    process = start("record-real", "--port", port, "--out", log, "--no-calibrate", "--json", "--reserve-mb", 0)
    grown(log)
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    facts = json.loads(out)
    read = read_log(log)
    assert not read.torn
    assert facts["ended"] == "stopped"
    assert facts["rows"] == len(read.joint_position) > 10
    assert facts["sha256"] == read.sha256


def test_a_recording_that_was_to_last_longer_says_what_is_kept_and_what_goes_on(port, tmp_path):
    log = tmp_path / "my log.mcap"
    process = start("record-real", "--port", port, "--out", log, "--no-calibrate", "--duration", 60, "--reserve-mb", 0)
    grown(log)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    read = read_log(log)
    assert process.returncode == 130
    assert f"ended      stopped\nsha256     {read.sha256}\nnext       candata import log '{log}' --out DATASET\n" in out
    assert re.search(
        rf"^stopped: {len(read.joint_position)} states over \d+\.\d s are kept in {log}, whole$", err, re.M
    )
    assert err.endswith(f"  to go on: candata import log '{log}' --out DATASET\n")


def grown(log) -> None:
    """Wait until a log holds some states."""
    until = time.monotonic() + 20
    while (not log.exists() or log.stat().st_size < 10_000) and time.monotonic() < until:
        time.sleep(0.01)


def test_under_nohup_a_hangup_ends_nothing(port, tmp_path):
    log = tmp_path / "log.mcap"
    standing = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # what nohup does; a child inherits it
    try:
        process = start("record-real", "--port", port, "--out", log, "--no-calibrate", "--json", "--reserve-mb", 0)
    finally:
        signal.signal(signal.SIGHUP, standing)
    grown(log)
    process.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    before = log.stat().st_size
    time.sleep(0.7)
    assert log.stat().st_size > before
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert json.loads(out)["ended"] == "stopped"


def test_nobody_to_show_it_to_ends_nothing(port, tmp_path):
    log = tmp_path / "log.mcap"
    arguments = ("--no-calibrate", "--plain", "--reserve-mb", 0, "--duration", 1.5)
    process = start("record-real", "--port", port, "--out", log, *arguments)
    process.stderr.close()  # as in `record-real ... 2>&1 | head`
    out = process.stdout.read()
    process.stdout.close()
    assert process.wait(timeout=30) == 0
    assert "ended      duration" in out
    assert not read_log(log).torn


def test_settings_reach_the_log(port, tmp_path, candata):
    log = tmp_path / "log.mcap"
    code, _, err = candata(
        "record-real",
        "--port",
        port,
        "--out",
        log,
        "--duration",
        0.5,
        "--no-calibrate",
        "--reserve-mb",
        0,
        "--newton-per-count",
        0.05,
        "--rate",
        20,
        "--json",
    )
    assert code == 0, err
    meta = read_log(log).meta
    assert (meta.newton_per_count, meta.rate_hz, meta.device, meta.port) == (0.05, 20.0, "xhand", port)


def test_no_such_port_exits_with_3_and_leaves_nothing(tmp_path, candata):
    code, out, err = candata("record-real", "--port", tmp_path / "no", "--out", tmp_path / "log.mcap")
    assert (code, out) == (3, "")
    assert err.startswith("no such port\n")
    assert "Traceback" not in err
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--device", "xhnad"), "unknown device 'xhnad'"),
        (("--newton-per-count", "0"), "--newton-per-count must be above zero"),
        (("--rate", "-1"), "--rate must be above zero"),
        (("--duration", "nan"), "--duration must be above zero"),
    ],
)
def test_wrong_options_exit_with_2(port, tmp_path, options, words, candata):
    code, _, err = candata("record-real", "--port", port, "--out", tmp_path / "log.mcap", *options)
    assert code == 2
    assert words in err
    assert not (tmp_path / "log.mcap").exists()


def test_a_failure_still_prints_the_report(port, tmp_path, candata):
    log = tmp_path / "log.mcap"
    code, out, err = candata(
        "record-real",
        "--port",
        port,
        "--out",
        log,
        "--calibrate-s",
        0.5,
        "--newton-per-count",
        1,
        "--reserve-mb",
        0,
        "--json",
    )
    assert code == 3
    assert json.loads(out)["problem"] == "the hand was touched during calibration"
    assert "thumb_rota2 under 6.00 N" in err
    assert not read_log(log).torn


def test_recover_says_what_was_saved(port, tmp_path, candata):
    log = tmp_path / "log.mcap"
    candata("record-real", "--port", port, "--out", log, "--duration", 0.5, "--no-calibrate", "--reserve-mb", 0)
    data = log.read_bytes()
    log.write_bytes(data[: int(0.6 * len(data))])
    code, out, err = candata("recover", log, "--json")
    assert code == 0, err
    saved = json.loads(out)
    assert saved["torn"]
    assert saved["messages"]["/hand/joint_states"] == len(read_log(saved["out"]).joint_position)
    code, out, _ = candata("recover", log, "--out", tmp_path / "again.mcap")
    assert code == 0
    assert f"{log} is torn: " in out
    assert "/hand/joint_states" in out
    code, _, err = candata("recover", log)
    assert code == 2
    assert "exists already" in err


def test_recover_refuses_an_empty_log(tmp_path, candata):
    (tmp_path / "log.mcap").touch()
    code, out, err = candata("recover", tmp_path / "log.mcap")
    assert (code, out) == (2, "")
    assert err.startswith("the log is empty: it holds no byte\n")
