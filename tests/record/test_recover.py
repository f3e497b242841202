"""Recovery saves what stands before the tear and leaves the original as it is."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from candata.errors import DataError, UsageError
from candata.record.devices._contract import States
from candata.record.logs import LogMeta, LogWriter, read_log
from candata.record.recover import recover

META = LogMeta(
    device="d",
    joint_names=("a",),
    fingertip_names=("t",),
    taxels=0,
    newton_per_count=0.1,
    count_low=(-128, -128, 0),
    count_high=(127, 127, 255),
    rate_hz=80.0,
)


@pytest.fixture
def torn(tmp_path, rng):
    """A log of a thousand rows, cut in its middle."""
    path = tmp_path / "log.mcap"
    writer = LogWriter(path, META)
    rows = 1000
    motors = np.zeros((rows, 1))
    force = np.zeros((rows, 1, 3), np.int16)
    for i, value in enumerate(rng.normal(size=(rows, 1))):
        part = States(value[None], motors[:1], motors[:1], force[:1], np.zeros((1, 1, 0, 3), np.int16))
        writer.states([i * 12_500_000], part)
        if i % 100 == 0:
            writer.flush()
    writer.statistics(0, {"rate_hz": 1.0})
    writer.close()
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


def test_the_recovered_log_is_whole_and_says_the_same(torn):
    before = torn.read_bytes()
    saved = recover(torn)
    assert torn.read_bytes() == before
    log, old = read_log(saved.out), read_log(torn)
    assert (old.torn, log.torn) == (True, False)
    assert len(log.joint_position) > 300
    assert log.meta == old.meta
    for name in ("state_time_ns", "joint_position", "force_counts"):
        np.testing.assert_array_equal(getattr(log, name), getattr(old, name))
    assert saved.torn
    assert saved.messages["/hand/joint_states"] == len(log.joint_position)
    assert saved.duration_s == pytest.approx((len(log.joint_position) - 1) * 0.0125)
    assert 0 < saved.read_bytes <= saved.total_bytes == len(before)
    assert saved.out.endswith("log.recovered.mcap")


def test_any_reader_takes_the_recovered_log(torn):
    from mcap.reader import make_reader

    saved = recover(torn)
    with open(saved.out, "rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary.statistics.message_count == sum(saved.messages.values())


def test_a_whole_log_is_copied_and_called_whole(torn):
    first = recover(torn)
    again = recover(Path(first.out), torn.with_name("again.mcap"))
    assert not again.torn
    assert again.messages == first.messages


def test_a_standing_file_is_refused(torn):
    recover(torn)
    with pytest.raises(UsageError, match="exists already"):
        recover(torn)


def test_nothing_is_left_of_a_failed_recovery(torn, tmp_path):
    torn.write_bytes(b"")
    with pytest.raises(DataError, match="the log is empty"):
        recover(torn)
    assert os.listdir(tmp_path) == ["log.mcap"]


def test_a_killed_recording_is_recovered(hand, tmp_path):
    one = hand()
    log = tmp_path / "log.mcap"
    command = ["record-real", "--port", one.port, "--out", str(log), "--no-calibrate", "--plain"]
    process = subprocess.Popen(
        [sys.executable, "-m", "candata_cli.main", *command],
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    until = time.monotonic() + 20
    while (not log.exists() or log.stat().st_size < 20_000) and time.monotonic() < until:
        time.sleep(0.01)
    (reader,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.kill()
    killed_ns = time.time_ns()
    process.wait()
    while Path(f"/proc/{reader}").exists() and time.monotonic() < until:
        time.sleep(0.01)
    assert not Path(f"/proc/{reader}").exists(), "the reader outlives its recorder"
    saved = read_log(recover(log).out)
    assert len(saved.joint_position) > 20
    # 0.25 s between two flushes, and room for a busy machine; benchmarks/record.py holds it to 0.3 s.
    assert killed_ns - saved.state_time_ns[-1] < 1.0e9
