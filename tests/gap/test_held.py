"""Sensors slower than the log: found, and compared when they are new."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.noise import sensor_noise
from candata.gap.data.recordings import recordings
from candata.gap.data.sample_hold import held_readings, only_new, sources
from candata.gap.measure.floor import floor
from candata.gap.measure.score import score
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import layout, residual
from candata.gap.replay.starts import starts
from candata.schema.scene import Noise
from candata.simulate.episodes import add_noise

#: Rows in which a 30 Hz sensor is new in a 100 Hz log: every third or fourth.
SLOW = np.unique(np.ceil(np.arange(60) * 100 / 30).astype(int))


def stepped(values, rows=SLOW):
    """Values `(E, T, ...)` held between some rows."""
    last = np.searchsorted(rows, np.arange(values.shape[1]), side="right") - 1
    return values[:, rows[last]]


def test_a_slow_sensor_is_found_with_the_rows_in_which_it_is_new(rng):
    values = rng.standard_normal((4, 160, 3))
    found, notes = sources({"object_pose": stepped(values), "joint_position": values}, 100.0)
    assert set(found) == {"object_pose"}
    assert set(np.unique(found["object_pose"])) == set(SLOW[SLOW < 160])
    assert notes == ("object_pose is new only every 3.3 rows (33 ms), and compared then",)


@pytest.mark.parametrize("every", [2, 5])
def test_any_regular_interval_is_found(rng, every):
    values = stepped(rng.standard_normal((2, 160, 1)), np.arange(0, 160, every))
    found, _ = sources({"fingertip_force": values}, 100.0)
    assert (found["fingertip_force"] == np.arange(160) // every * every).all()


def test_what_rests_is_rounded_or_drops_out_is_not_held(rng):
    t = np.arange(160) / 100
    noise = rng.standard_normal((4, 160, 1))
    rest = np.where(t[:, None] < 0.8, 0.0, np.sin(t)[:, None]) * np.ones((4, 1, 1))
    rounded = np.round(np.sin(3 * t)[:, None] + 0.02 * noise, 1)
    faint = np.round(0.012 * noise / 0.05) * 0.05
    gaps = np.where(rng.random((4, 160, 1)) < 0.5, np.nan, noise)
    assert sources({"a": rest, "b": rounded, "c": faint, "d": gaps, "e": np.zeros((4, 160, 1))}, 100.0) == ({}, ())


def test_lost_frames_of_a_slow_sensor_are_readings_that_are_held_longer(rng):
    rows = np.delete(np.arange(0, 160, 4), [5, 17, 30])
    found, _ = sources({"a": stepped(rng.standard_normal((3, 160, 2)), rows)}, 100.0)
    assert set(np.unique(found["a"])) == set(rows)


def test_holding_and_thinning_follow_the_rows(rng):
    values = rng.standard_normal((2, 8, 1))
    rows = np.array([[0, 0, 2, 2, 4, 4, 6, 6], [0, 0, 0, 3, 3, 3, 6, 6]])
    assert (held_readings(values, rows)[1, :, 0] == values[1, rows[1], 0]).all()
    # Three readings of the second episode, so three of the first.
    assert (only_new(values, rows)[..., 0] == [values[0, [0, 2, 4], 0], values[1, [0, 3, 6], 0]]).all()
    assert held_readings(values, None) is values
    assert only_new(values, None) is values


@pytest.fixture
def slow_arm(arm, arm_episodes):
    """Twelve noisy episodes of an arm that nothing is wrong with, its encoders read at 30 Hz."""
    found = []
    for e in arm_episodes(count=12):
        joints = stepped(np.array(e["joint_position"])[None])[0]
        found.append(replace(e, arrays={**e.arrays, "joint_position": joints}))
    return recordings(arm, found)


def loss(arm, recs):
    """Mean loss of recordings in floors of the nominal scene."""
    replayer, begin = Replayer(arm), starts(arm, recs)
    readings = replay_all(replayer, recs, begin, [()])[0]
    plan = layout(arm, recs, begin, readings)
    level = floor(replayer, recs, begin, plan, arm.file.noise, np.random.default_rng(0), 8)
    raw = residual(recs, plan, readings)
    points = score(raw, level, plan)
    return float(points.loss(points.normal(raw)).mean())


def test_a_slow_sensor_opens_no_gap(arm, slow_arm):
    # Null losses of a dozen episodes lie within a tenth of one.
    assert loss(arm, slow_arm) == pytest.approx(1, abs=0.15)
    # Taken as if every row were new, what the arm moves meanwhile is a gap.
    assert loss(arm, replace(slow_arm, sources={})) > 1.5


def test_the_other_episodes_keep_their_rows(slow_arm):
    some = slow_arm.take([3, 1])
    assert (some.sources["joint_position"] == slow_arm.sources["joint_position"][[3, 1]]).all()


def test_missing_readings_stay_missing(arm, slow_arm):
    joints = slow_arm.readings["joint_position"].copy()
    joints[:, 60:80] = np.nan
    cut = replace(slow_arm, readings={"joint_position": joints})
    replayer, begin = Replayer(arm), starts(arm, cut)
    readings = replay_all(replayer, cut, begin, [()])[0]
    raw = residual(cut, layout(arm, cut, begin, readings), readings)
    assert np.isnan(raw[:, 12:16]).all()
    assert np.isfinite(raw[:, 17:30]).all()


def test_noise_of_a_slow_sensor_is_read_off_what_is_new(plain_recordings, rng):
    still = {"joint_position": np.full((8, 160, 2), 0.3)}
    noisy = add_noise(still, Noise(joint_position=0.01), rng)
    recs = plain_recordings(joint_position=stepped(noisy["joint_position"]))
    recs = replace(recs, sources=sources(recs.readings, 100.0)[0])
    # 47 readings an episode are five windows of eight: 40 windows a column, known to 10 %.
    assert sensor_noise(None, recs, still).noise.joint_position == pytest.approx(0.01, rel=0.25)
