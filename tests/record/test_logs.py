"""A log reads back as it was written, and as far as it was written where it is torn."""

from __future__ import annotations

import errno
import hashlib
import os
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from candata import plugins
from candata.errors import DataError, SetupError, UsageError
from candata.formats._mcap_messages import message
from candata.record import logs
from candata.record.calibration import Calibration
from candata.record.devices._contract import Commands, States
from candata.record.logs import LogMeta, LogWriter, meta_of, read_log

META = LogMeta(
    device="d",
    joint_names=("a", "b"),
    fingertip_names=("t", "u", "v"),
    taxels=4,
    newton_per_count=0.1,
    count_low=(-128, -128, 0),
    count_high=(127, 127, 255),
    rate_hz=80.0,
    wall_offset_ns=1_700_000_000_000_000_000,
)


def states_of(rng: np.random.Generator, rows: int) -> States:
    return States(
        joint_position=rng.normal(size=(rows, 2)),
        motor_current=rng.normal(size=(rows, 2)),
        motor_temperature=rng.normal(size=(rows, 2)),
        force_counts=rng.integers(-128, 256, (rows, 3, 3)).astype(np.int16),
        taxel_counts=rng.integers(-128, 256, (rows, 3, 4, 3)).astype(np.int16),
    )


def write(path, states: States, meta: LogMeta = META) -> np.ndarray:
    """Write a log in which each state follows a request by 1 ms; return the stamps of the states."""
    stamps = 5_000_000_000 + np.arange(len(states.joint_position)) * 12_500_000
    writer = LogWriter(path, meta)
    for i, stamp in enumerate(stamps.tolist()):
        writer.wire(b"wire", stamp)
        writer.commands([stamp - 1_000_000], Commands(states.joint_position[i : i + 1] + 1))
        writer.states([stamp], States(*(value[i : i + 1] for value in vars(states).values())))
    writer.statistics(int(stamps[-1]), {"rate_hz": 80.0})
    writer.close()
    return stamps


@pytest.fixture
def states(rng) -> States:
    return states_of(rng, 300)


@pytest.fixture
def written(tmp_path, states):
    write(tmp_path / "log.mcap", states)
    return tmp_path / "log.mcap"


def test_a_log_reads_back_as_it_was_written(tmp_path, states):
    path = tmp_path / "log.mcap"
    stamps = write(path, states)
    log = read_log(path)
    assert log.meta == META
    assert not log.torn
    assert log.calibration is None
    np.testing.assert_array_equal(log.state_time_ns, stamps + META.wall_offset_ns)
    np.testing.assert_array_equal(log.command_time_ns, stamps - 1_000_000 + META.wall_offset_ns)
    np.testing.assert_array_equal(log.joint_target, states.joint_position + 1)
    for name in ("joint_position", "motor_current", "force_counts", "taxel_counts"):
        np.testing.assert_array_equal(getattr(log, name), getattr(states, name))
        assert getattr(log, name).dtype == getattr(states, name).dtype
    assert log.statistics == ({"rate_hz": 80.0},)
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_device_without_taxels_has_none(tmp_path, states):
    write(tmp_path / "log.mcap", states, META.model_copy(update={"taxels": 0}))
    log = read_log(tmp_path / "log.mcap")
    assert log.taxel_counts is None
    assert len(log.force_counts) == 300


def test_a_log_without_a_frame_has_empty_arrays(tmp_path):
    LogWriter(tmp_path / "log.mcap", META).close()
    log = read_log(tmp_path / "log.mcap")
    assert log.joint_position.shape == (0, 2)
    assert log.force_counts.shape == (0, 3, 3)
    assert log.taxel_counts.shape == (0, 3, 4, 3)
    assert not log.torn


def test_the_calibration_reads_back(tmp_path, rng):
    bias = Calibration(rng.normal(size=(3, 3)), rng.normal(size=(3, 4, 3)), 240, 3.0, np.ones((3, 3)), np.zeros(2), 7)
    writer = LogWriter(tmp_path / "log.mcap", META)
    writer.calibration(bias)
    writer.close()
    read = read_log(tmp_path / "log.mcap").calibration
    for name, value in vars(bias).items():
        np.testing.assert_array_equal(getattr(read, name), value)
    endless = LogWriter(tmp_path / "endless.mcap", META)
    endless.calibration(replace(bias, end_ns=float("inf")))
    endless.close()
    with pytest.raises(DataError, match="does not hold what its metadata says"):
        read_log(tmp_path / "endless.mcap")


def test_what_was_flushed_is_read_without_an_end(tmp_path, states):
    writer = LogWriter(tmp_path / "log.mcap", META)
    stamps = list(range(300))
    writer.states(stamps, states)
    writer.flush()
    log = read_log(tmp_path / "log.mcap")
    assert log.torn
    np.testing.assert_array_equal(log.joint_position, states.joint_position)
    writer.close()
    assert not read_log(tmp_path / "log.mcap").torn


@pytest.mark.parametrize("share", [0.1, 0.35, 0.6, 0.9])
def test_a_log_cut_anywhere_gives_the_first_rows(written, states, share):
    data = written.read_bytes()
    written.write_bytes(data[: int(share * len(data))])
    log = read_log(written)
    rows = len(log.joint_position)
    assert log.torn
    # A chunk holds 64 KiB, which is about a hundred rows of this small device: no more than that is lost.
    assert rows >= 300 * share - 130
    np.testing.assert_array_equal(log.joint_position, states.joint_position[:rows])
    np.testing.assert_array_equal(log.taxel_counts, states.taxel_counts[:rows])


def test_every_cut_of_a_small_log_is_read_or_refused(tmp_path, rng):
    path = tmp_path / "log.mcap"
    write(path, states_of(rng, 2))
    data = path.read_bytes()
    rows = set()
    for cut in range(1, len(data), 29):
        path.write_bytes(data[:cut])
        try:
            rows.add(len(read_log(path).joint_position))
        except DataError:
            rows.add(None)
    assert rows == {None, 0, 2}


def test_a_damaged_chunk_costs_its_own_rows_only(tmp_path, rng):
    states = states_of(rng, 900)
    path = tmp_path / "log.mcap"
    write(path, states)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    log = read_log(path)
    assert log.damaged_chunks == 1
    assert not log.torn
    rows = np.flatnonzero(np.isin(states.joint_position[:, 0], log.joint_position[:, 0]))
    assert 600 < len(rows) < 900
    np.testing.assert_array_equal(log.joint_position, states.joint_position[rows])
    np.testing.assert_array_equal(log.force_counts, states.force_counts[rows])


def test_a_log_of_zero_bytes_is_refused(tmp_path):
    path = tmp_path / "log.mcap"
    path.touch()
    with pytest.raises(DataError, match="the log is empty"):
        read_log(path)


def test_what_is_no_log_is_refused(tmp_path):
    path = tmp_path / "log.mcap"
    with pytest.raises(DataError, match="no such log"):
        read_log(path)
    path.write_bytes(b"PAR1 is another kind of file")
    with pytest.raises(DataError, match="the file is no log"):
        read_log(path)
    from mcap.writer import Writer

    with path.open("wb") as file:
        foreign = Writer(file)
        foreign.start()
        foreign.finish()
    with pytest.raises(DataError, match=r"metadata record 'candata\.log'"):
        read_log(path)


def test_a_standing_file_is_never_written_over(written):
    before = written.read_bytes()
    with pytest.raises(UsageError, match="exists already"):
        LogWriter(written, META)
    assert written.read_bytes() == before


def test_the_first_error_of_the_disk_is_final_and_costs_nothing_flushed(tmp_path, rng, file_limit):
    path = tmp_path / "log.mcap"
    states = states_of(rng, 10)
    writer = LogWriter(path, META)
    flushed = []

    def fill():
        while True:
            writer.states(range(10), states)
            writer.flush()
            flushed.append(10)

    with pytest.raises(SetupError, match="the log cannot be written") as caught:
        fill()
    assert caught.value.exit_code == 3
    assert writer.failed
    with pytest.raises(SetupError, match="closed after an error"):
        writer.wire(b"more", 0)
    writer.close()
    log = read_log(path)
    assert len(log.joint_position) == sum(flushed) > 0
    # No half record stands at the end: what is there was committed.
    assert os.path.getsize(path) < 150_000


def test_an_error_of_the_last_sync_is_told_at_the_end(tmp_path, rng, monkeypatch):
    writer = LogWriter(tmp_path / "log.mcap", META)
    writer.states(range(10), states_of(rng, 10))
    writer.flush()
    real = os.fsync

    def once(handle):
        monkeypatch.setattr(os, "fsync", real)
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", once)
    writer.sync_behind()
    with pytest.raises(SetupError, match="Input/output error"):
        writer.close()
    assert len(read_log(tmp_path / "log.mcap").joint_position) == 10


def test_a_folder_that_is_a_file_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"the output's folder is a file\n  where: .*file\n"):
        LogWriter(tmp_path / "file" / "log.mcap", META)


def test_taxels_stand_in_memory_about_twice_while_read(tmp_path, rng):
    meta = META.model_copy(update={"taxels": 500})
    rows = 200
    taxels = rng.integers(0, 9, (rows, 3, 500, 3)).astype(np.int16)
    write(tmp_path / "log.mcap", replace(states_of(rng, rows), taxel_counts=taxels), meta)
    tracemalloc.start()
    try:
        log = read_log(tmp_path / "log.mcap")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert np.array_equal(log.taxel_counts, taxels)
    # The messages and the array; the rest of the log is small beside them.
    assert peak < 2.7 * taxels.nbytes


def test_the_metadata_of_a_device_take_overrides():
    device = plugins.load("candata.record.devices", "DEVICE", "xhand")
    meta = meta_of(device, "xhand", newton_per_count=0.05)
    assert meta.newton_per_count == 0.05
    assert meta.joint_names == device.joint_names
    assert LogMeta.model_validate_json(meta.model_dump_json()) == meta


def test_every_message_carries_its_description_in_the_file(written):
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap.reader import make_reader

    with written.open("rb") as file:
        seen = {}
        for schema, channel, item in make_reader(file).iter_messages():
            seen.setdefault(channel.topic, (schema, item))
    assert set(seen) == {*logs._MESSAGES, logs.STATISTICS}
    for schema, item in seen.values():
        if schema.encoding == "protobuf":
            pool = descriptor_pool.DescriptorPool()
            for one in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(one)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            assert str(kind.FromString(item.data)) == str(message(schema.name).FromString(item.data)) != ""
