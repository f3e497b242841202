"""Noise of sensors: measured in repeats, declared, or read off quiet stretches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.noise import SMALLEST, sensor_noise
from candata.gap.data.recordings import recordings
from candata.gap.data.repetition import repeated_pairs
from candata.gap.data.rounding import before_rounding, force_step
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.starts import starts
from candata.schema.scene import Noise
from candata.simulate.episodes import add_noise

#: A tenth of 150 windows with five degrees of freedom each know a standard deviation to 4 %; the quietest column of a
#: few lies lower by as much.
SURE = 0.15


def still(recs):
    """Readings of a replay in which nothing moves: what is read off the recording alone is the smaller."""
    return {name: np.cumsum(np.ones_like(v), axis=1) ** 3 for name, v in recs.readings.items()}


def swing(rows=160):
    t = np.arange(rows) / 100
    return 0.5 * np.clip((t - 0.5) / 0.4, 0, 1) * np.sin(2 * np.pi * t)


@pytest.mark.parametrize(("times", "told"), [(1.0, False), (1.2, False), (2.0, True)])
@pytest.mark.parametrize("fault", [{}, {"frictionloss_Nm": 0.3}])
def test_clearly_more_noise_than_declared_counts(arm, arm_episodes, planted, rng, times, told, fault):
    """The arm swings all the time, and a dry joint moves it otherwise: neither is taken for noise."""
    recs = recordings(arm, arm_episodes(planted("joint_dry_friction", **fault) if fault else (), noise=False))
    louder = Noise(joint_position=times * arm.file.noise.joint_position)
    recs = replace(recs, readings=add_noise(recs.readings, louder, rng))
    readings = replay_all(Replayer(arm), recs, starts(arm, recs), [()])[0]
    kind, noise, notes, _ = sensor_noise(arm.file.noise, recs, readings)
    if not told:
        assert (kind, noise, notes) == ("declared", arm.file.noise, ())
        return
    assert kind == "assumed"
    assert noise.joint_position == pytest.approx(0.002, rel=SURE)
    before, after = notes[0].split(" declared, ")
    assert before == "noise of joint position: 0.001 rad"
    assert float(after.split(" rad seen")[0]) == pytest.approx(0.002, rel=SURE)


@pytest.mark.parametrize("declared", [None, Noise()])
def test_without_declared_noise_the_floor_is_assumed(plain_recordings, declared):
    recs = plain_recordings(joint_position=np.full((2, 40, 2), 0.3))
    # Nothing moves and there is no object: what good sensors cannot resolve is left.
    assert sensor_noise(declared, recs, still(recs))[:3] == ("assumed", SMALLEST, ())


def test_positions_that_lie_on_a_parabola_exactly_have_no_noise(plain_recordings):
    """What a fit leaves of simulated readings is rounding, which may be less than nothing."""
    t = np.arange(320) / 100
    joints = np.stack([1.276 + 0.31 * t + 0.0173 * t**2, 0.861 - 0.13 * t], axis=1)
    recs = plain_recordings(joint_position=np.repeat(joints[None], 3, axis=0))
    assert sensor_noise(None, recs, recs.readings)[:3] == ("assumed", SMALLEST, ())


@pytest.mark.parametrize("size", [0.002, 0.02])
@pytest.mark.parametrize("moving", [False, True])
def test_white_noise_of_known_size_is_recovered(plain_recordings, rng, size, moving):
    recs = plain_recordings(joint_position=moving * swing()[:, None] + size * rng.standard_normal((8, 160, 2)))
    assert sensor_noise(None, recs, still(recs)).noise.joint_position == pytest.approx(size, rel=SURE)


def test_noise_of_a_pose_tells_position_from_rotation(plain_recordings, rng):
    pose = np.tile([0.1, 0.2, 0.3, 0, 1, 0, 0], (8, 160, 1))
    recs = plain_recordings(**add_noise({"object_pose": pose}, Noise(object_pose=(0.004, 0.05)), rng))
    position, rotation = sensor_noise(None, recs, still(recs)).noise.object_pose
    assert position == pytest.approx(0.004, rel=SURE)
    assert rotation == pytest.approx(0.05, rel=SURE)


def test_a_moving_recording_is_not_taken_for_noise(plain_recordings, rng):
    t = np.arange(160) / 100
    wave = np.where(t < 0.5, 0.0, 0.5 * np.sin(12 * np.pi * (t - 0.5)))
    recs = plain_recordings(
        joint_position=np.repeat(wave[None, :, None], 8, 0) + 0.002 * rng.standard_normal((8, 160, 1))
    )
    # A parabola over 80 ms leaves up to ten times the noise of the sine: the windows before it tell the noise.
    assert sensor_noise(None, recs, still(recs)).noise.joint_position == pytest.approx(0.002, rel=SURE)


def test_a_replay_takes_motion_off(plain_recordings, rng):
    wave = np.tile(0.5 * np.sin(12 * np.pi * np.arange(160) / 100)[:, None], (8, 1, 2))
    recs = plain_recordings(joint_position=wave + 0.002 * rng.standard_normal(wave.shape))
    found = sensor_noise(None, recs, {"joint_position": wave})
    assert found.noise.joint_position == pytest.approx(0.002, rel=SURE)


@pytest.mark.parametrize(("step", "size"), [(0.05, 0.02), (0.05, 0.03), (0.02, 0.03), (0.0, 0.03)])
def test_rounded_forces_tell_their_step_and_the_noise_before_it(plain_recordings, rng, step, size):
    free = {"fingertip_force": np.zeros((8, 160, 2, 3))}
    recs = plain_recordings(**add_noise(free, Noise(fingertip_force=size, force_step=step), rng))
    noise = sensor_noise(None, recs, still(recs)).noise
    assert noise.force_step == pytest.approx(step)
    assert noise.fingertip_force == pytest.approx(size, rel=SURE)


def test_forces_that_are_whole_multiples_of_nothing_have_no_step(rng):
    assert force_step({"fingertip_force": rng.standard_normal((2, 20, 1, 3))}) == 0
    assert force_step({"fingertip_force": np.zeros((2, 20, 1, 3))}) == 0
    assert force_step({}) == 0


def test_noise_that_rounding_hides_is_not_seen():
    assert before_rounding(0.0, 0.05) == 0
    assert before_rounding(0.05**2 / 12 + 4, 0.05) == pytest.approx(2)
    assert before_rounding(4.0, 0.0) == 2


def played_again(plain_recordings, rng, size=0.002, copies=2, late=0):
    """Six episodes: three motions, each `copies` times, so fast that nothing in them is quiet."""
    t = np.arange(160) / 100
    waves = np.stack([np.sin(2 * np.pi * f * t) for f in (5.0, 6.0, 7.0)])
    which = np.arange(6) % 3 if copies == 2 else np.array([0, 0, 1, 2, 2, 2])[:6]
    commands = waves[which][..., None]
    joints = commands + size * rng.standard_normal((6, 160, 4))
    lengths = np.where(np.arange(6) == 5, 160 - late, 160)
    return plain_recordings(commands=commands, lengths=lengths, joint_position=joints)


def test_repeats_are_episodes_of_the_same_commands(plain_recordings, rng):
    assert repeated_pairs(played_again(plain_recordings, rng)) == [(0, 3), (1, 4), (2, 5)]
    assert repeated_pairs(played_again(plain_recordings, rng, copies=3)) == [(0, 1), (3, 4), (4, 5)]
    # A fifth shorter is another motion, a row is the logger's doing.
    assert repeated_pairs(played_again(plain_recordings, rng, late=32)) == [(0, 3), (1, 4)]
    assert repeated_pairs(played_again(plain_recordings, rng, late=1)) == [(0, 3), (1, 4), (2, 5)]


def test_what_was_never_commanded_is_no_repeat(plain_recordings):
    assert repeated_pairs(plain_recordings(joint_position=np.zeros((4, 40, 1)))) == []
    assert repeated_pairs(plain_recordings(commands=np.ones((4, 40, 1)), joint_position=np.zeros((4, 40, 1)))) == []


@pytest.mark.parametrize("declared", [None, Noise(joint_position=0.002), Noise(joint_position=0.0005)])
def test_noise_is_measured_in_repeats_whatever_is_declared(plain_recordings, rng, declared):
    recs = played_again(plain_recordings, rng)
    kind, noise, notes, _ = sensor_noise(declared, recs, still(recs))
    assert kind == "measured"
    assert noise.joint_position == pytest.approx(0.002, rel=SURE)
    assert len(notes) == (declared is not None and declared.joint_position < 0.001)
    # Off the recording alone, the motion is taken for noise: without repeats it is ten times too large.
    alone = recs.take([0, 1, 2])
    assert sensor_noise(None, alone, still(alone)).noise.joint_position > 0.02


@pytest.mark.parametrize(("off", "confirmed"), [(0.953, True), (1.047, True), (0.7, False), (1.4, False)])
def test_what_repeats_confirm_stands_as_it_is_declared(plain_recordings, rng, off, confirmed):
    """Null replays are kept by the noise: it is the same for recordings that differ in what little they know of it."""
    recs = played_again(plain_recordings, rng)
    seen = sensor_noise(None, recs, still(recs)).noise.joint_position
    # What was not recorded counts as declared, and so do all digits.
    declared = Noise(
        object_pose=(0.00123, 0.0087266), joint_position=off * seen, fingertip_force=0.0234, force_step=0.01
    )
    kind, noise, _, error = sensor_noise(declared, recs, still(recs))
    assert (error == 0) is confirmed
    assert kind == "measured"
    # What is declared larger than measured counts: the floor is never below it.
    larger = max(seen, declared.joint_position)
    assert noise.joint_position == (declared.joint_position if confirmed else pytest.approx(larger, rel=5e-3))
    assert noise.object_pose == declared.object_pose
    assert (noise == declared) is confirmed


def test_no_declared_noise_confirms_none(plain_recordings, rng):
    """Played again without noise: what good sensors cannot resolve is left, not nothing."""
    recs = played_again(plain_recordings, rng)
    quiet = replace(recs, readings={n: np.zeros_like(v) for n, v in recs.readings.items()})
    for declared in (None, Noise(), Noise(fingertip_force=0.02)):
        kind, noise, _, _ = sensor_noise(declared, quiet, still(quiet))
        assert (kind, noise.joint_position, noise.object_pose) == ("measured", SMALLEST.joint_position, (2e-4, 1e-3))


def test_one_repeat_may_be_an_accident(plain_recordings, rng):
    recs = played_again(plain_recordings, rng).take([0, 1, 2, 3])
    assert sensor_noise(None, recs, still(recs)).kind == "assumed"


def test_noise_of_slides_is_read_apart_from_that_of_hinges(plain_recordings, rng):
    """Rails are read ten times finer: neither number stands for the other."""
    size = np.array([0.002, 0.0002, 0.002])
    recs = plain_recordings(joint_position=size * rng.standard_normal((8, 160, 3)))
    noise = sensor_noise(None, recs, still(recs), np.array([False, True, False])).noise
    assert noise.joint_position == pytest.approx(tuple(size), rel=SURE)


def test_noise_declared_for_each_joint_is_added_to_each(rng):
    size = (0.001, 0.01)
    noisy = add_noise({"joint_position": np.zeros((50, 100, 2))}, Noise(joint_position=size), rng)
    # 5000 values are known to 1 %.
    assert noisy["joint_position"].std((0, 1)) == pytest.approx(size, rel=0.05)


def test_few_windows_leave_a_loss_less_sure_than_many(plain_recordings, rng):
    few, many = (plain_recordings(joint_position=0.002 * rng.standard_normal((n, 160, 2))) for n in (4, 64))
    errors = [sensor_noise(None, recs, still(recs)).loss_error for recs in (few, many)]
    # Sixteen times as many windows: a quarter of the error.
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.01)
    assert sensor_noise(Noise(joint_position=0.002), many, still(many)).loss_error == 0
