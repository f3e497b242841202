"""The labelled servo sets: what each run keeps of its readings and labels, on which rows; other files are refused."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import DataError, SetupError
from candata.fetch import SOURCES
from candata.fetch import rh56_contacts as rh56
from candata.fetch import so101_motions as so101
from candata.fetch import xl330_pendulum as xl330

SETS = ("xl330_pendulum", "so101_motions", "rh56_contacts")


def pendulum_columns(stamps_s, **columns):
    """A run of the pendulum in the columns of its table, at rest but for what is given."""
    rows = len(stamps_s)
    still = {
        "run": np.array(["2026-01-15_10h28m10"] * rows, object),
        "trajectory": np.array(["lift_and_drop"] * rows, object),
        "kp": np.full(rows, 100),
        "mass_kg": np.full(rows, 0.49),
        "length_m": np.full(rows, 0.1),
        "supply_V": np.full(rows, 7.4),
        "time_s": np.asarray(stamps_s, float),
        "torque_on": np.ones(rows, bool),
    }
    numbers = ("goal_rad", "position_rad", "speed", "load", "volts", "temp_C")
    return still | {name: np.zeros(rows) for name in numbers} | columns


def test_uneven_stamps_are_put_on_even_rows_where_the_readings_belong():
    stamps = np.cumsum(np.r_[0.0, [0.0053] * 40, [0.0035] * 60])
    run = pendulum_columns(stamps, position_rad=2 * stamps, torque_on=stamps < 0.2)
    (episode,) = xl330.episodes(run)
    assert np.ptp(np.diff(episode["time_ns"])) == 0
    # float32 keeps seven digits of a position.
    np.testing.assert_allclose(episode["joint_position"][:, 0], 2 * episode.time_s, atol=1e-6)
    assert episode.valid("joint_position").all()
    off = np.flatnonzero(~episode["torque_on"][:, 0])
    assert episode.time_s[off[0]] == pytest.approx(0.2, abs=0.005)


def test_a_duty_word_above_half_its_range_is_negative():
    stamps = np.arange(30) * 0.005
    run = pendulum_columns(stamps, load=np.where(stamps < 0.07, 65536 - 885, 885))
    (episode,) = xl330.episodes(run)
    assert (episode["joint_effort"][0, 0], episode["joint_effort"][-1, 0]) == (-885, 885)
    assert episode.meta.unscaled == ("joint_effort",)


def contact_columns(stamps_s, angle, stage, speed=250.0):
    """A trial of the finger in the columns of its table."""
    rows = len(stamps_s)
    return {
        "speed": np.full(rows, speed),
        "force_limit_g": np.full(rows, 500.0),
        "Trial_Index": np.full(rows, 3.0),
        "Mode": np.array(["speed"] * rows, object),
        "Stage": np.asarray(stage, object),
        "Middle_Angle": np.asarray(angle, float),
        "Middle_Force_g": np.full(rows, 100.0),
        "Middle_Force_N": np.full(rows, 100.0),
        "Force_Trigger_g": np.full(rows, 300.0),
        "Trial_Elapsed_s": np.asarray(stamps_s, float),
    }


def closing(waited_s, paused_s=0.0):
    """A finger that opens, is marked as closing, waits, and closes at 0.8 strokes a second; the log may pause."""
    stamps = np.r_[np.arange(40), 120 + np.arange(200)] / rh56.RATE_HZ
    since = stamps - 120 / rh56.RATE_HZ
    angle = np.where(stamps < 0.3, 650, 1000 - 800 * np.clip(since - waited_s, 0, 0.4))
    logged = (since < 0) | (since >= paused_s)
    stage = np.where(since < 0, "open", "contact")
    return contact_columns(stamps[logged], angle[logged], stage[logged])


@pytest.mark.parametrize(("waited_s", "paused_s"), [(0.05, 0.0), (0.6, 0.0), (0.3, 0.5)])
def test_the_finger_is_sent_where_it_starts_to_move(waited_s, paused_s):
    """The log tells when a stage was marked, not when the hand took the target; it may pause meanwhile."""
    (episode,) = rh56.episodes(closing(waited_s, paused_s))
    sent = int(np.argmax(episode["action"][:, 0] < 1))
    assert sent == rh56.REST_ROWS
    stroke, seen = episode["joint_position"][:, 0], episode.valid("joint_position")
    expected = 1 - 0.8 * np.clip((np.arange(len(episode)) - sent) / rh56.RATE_HZ, 0, 0.4)
    # A row is 0.01 of the stroke at this pace.
    np.testing.assert_allclose(stroke[seen], expected[seen], atol=0.011)


def test_trials_of_one_speed_last_equally_long_and_rows_beyond_the_log_are_not_valid():
    lengths = {len(e) for waited_s in (0.05, 0.6) for e in rh56.episodes(closing(waited_s))}
    assert len(lengths) == 1
    (episode,) = rh56.episodes(closing(1.0))
    assert not episode.valid("joint_position")[-1]
    assert episode.meta.invalid_counts["joint_position"] == (~episode.valid("joint_position")).sum()
    assert episode.valid("action").all()
    # 100 gram-force against the pad, in newtons: not the source's column in N, which holds grams.
    assert episode["fingertip_force"][0, 0, 2] == pytest.approx(-100 * 9.80665e-3)
    assert dict(episode.meta.labels) == {
        "mode": "speed",
        "speed": 250,
        "force_limit_g": 500,
        "force_trigger_g": 300,
        "trial": 3,
    }


@pytest.mark.parametrize("name", SETS)
def test_a_folder_without_the_table_and_a_download_are_refused_with_what_to_do(name, tmp_path):
    source = SOURCES.load(name)
    with pytest.raises(DataError, match="is missing"):
        source.from_folder(tmp_path)
    with pytest.raises(SetupError, match="--from FOLDER") as refused:
        source.download(tmp_path, print)
    assert source.origin in str(refused.value)


def test_the_prepared_pendulum(shared):
    episodes = list(xl330.TABLE.from_folder(shared / "realdata" / "xl330_pendulum").episodes)
    assert {(e.meta.labels["kp"], e.meta.task) for e in episodes} == {
        (kp, task)
        for kp in (100, 200, 400, 800)
        for task in ("sin_sin", "lift_and_drop", "up_and_down", "sin_time_square")
    }
    assert all(e.valid(channel).all() for e in episodes for channel in e.arrays if channel != "time_ns")
    assert {e.meta.task for e in episodes if not e["torque_on"].all()} == {"lift_and_drop"}
    # A label of 7.4 V; the reading sags below it under load and swings above.
    assert min(e["supply_voltage"].min() for e in episodes) < 6 < 8 < max(e["supply_voltage"].max() for e in episodes)


def test_the_prepared_arm(shared):
    episodes = list(so101.TABLE.from_folder(shared / "realdata" / "so101_motions").episodes)
    assert sum(map(len, episodes)) == 225_145
    steps_ns = np.concatenate([np.diff(e["time_ns"]) for e in episodes])
    assert np.ptp(steps_ns) > 1e5  # stamps are the recorded ones
    chirp = next(e for e in episodes if e.meta.id == "chirp_sweep")
    rates = np.gradient(chirp["joint_position"].astype(float), chirp.time_s, axis=0)
    # Reported velocities are those of the joints, jaw included, but for rounding and a lag of a row.
    slopes = (rates * chirp["joint_velocity"]).sum(0) / (chirp["joint_velocity"].astype(float) ** 2).sum(0)
    np.testing.assert_allclose(slopes, 1, atol=0.1)


def test_the_prepared_contacts(shared):
    episodes = list(rh56.TABLE.from_folder(shared / "realdata" / "rh56_contacts").episodes)
    assert len(episodes) == len({e.meta.id for e in episodes}) == 800
    assert {len(e) for e in episodes if e.meta.labels["speed"] == 25} == {488}
    slow = [e for e in episodes if e.meta.labels["speed"] == 25]
    strokes = np.stack([np.where(e.valid("joint_position"), e["joint_position"][:, 0], np.nan) for e in slow])
    assert np.nanstd(strokes[:, :360], axis=0).max() < 0.004  # until they touch, trials of one speed are repeats
    fast = [e for e in episodes if e.meta.labels["speed"] == 1000]
    peaks_g = [np.nanmax(-e["fingertip_force"][..., 2]) / 9.80665e-3 for e in fast]
    # At full speed the limit changes nothing (the set's own notes: 1659 to 1724 g and more at every limit).
    assert min(peaks_g) > 1500
