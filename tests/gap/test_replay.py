"""Replay: a recording replayed in its own world is itself; anything else shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.replay import replayer as module
from candata.gap.replay.replayer import ReplayedSteps, Replayer, needs_simulation, replay, replay_all
from candata.gap.replay.starts import Starts, starts
from candata.simulate import Observer, at_rest, rollout

#: Readings are stored as float32: half a last place of 1, and what a servo makes of it.
STORED = 1e-6
#: A twentieth of the declared noise [m or 1, rad, N]. Vectorised sines differ in their last place by where a number
#: stands in the batch, and stiff contact makes up to 2e-6 m and 2e-4 N of that.
CLOSE = {"object_pose": 5e-5, "joint_position": 1e-4, "fingertip_force": 1e-3}


@pytest.fixture(scope="module")
def squeezes(hand, played):
    """Two recordings with contact, without noise."""
    made = played(hand, count=2, duration_s=0.8, policies=("squeeze",), noise=False)
    recs = recordings(hand, made)
    assert np.abs(recs.readings["fingertip_force"]).max() > 0.3, "something is touched"
    return recs, starts(hand, recs)


@pytest.fixture(scope="module")
def variants(planted):
    return [
        (),
        planted("joint_damping", damping_Nms_rad=0.1),
        planted("object_mass", mass_scale=1.3),
        planted("actuation_delay", delay_s=0.03),
        planted("pose_latency", latency_s=0.05),
    ]


def largest(recs, readings, channel: str) -> float:
    return float(np.nanmax(np.abs(recs.readings[channel] - readings[channel])))


@pytest.mark.parametrize("effects", [(), ("joint_damping", 0.3)], ids=["nominal", "damped"])
def test_a_recording_replayed_in_its_own_world_is_itself(arm, arm_episodes, planted, effects):
    world = planted(effects[0], damping_Nms_rad=effects[1]) if effects else ()
    recs = recordings(arm, arm_episodes(world, count=4, noise=False))
    same, other = replay(Replayer(arm), recs, starts(arm, recs), [world, planted("armature", armature_kgm2=0.02)])
    assert largest(recs, same, "joint_position") < STORED
    # The control: another world is told apart by a thousand times as much.
    assert largest(recs, other, "joint_position") > 1000 * STORED


def test_what_is_simulated_is_counted_in_steps_of_episodes_and_heard_as_before(arm, arm_episodes, planted):
    recs = recordings(arm, arm_episodes((), count=2, noise=False))
    counted, heard = ReplayedSteps(), []
    worlds = [(), planted("armature", armature_kgm2=0.02), ()]
    replay_all(counted.watched(Replayer(arm, count=heard.append)), recs, starts(arm, recs), worlds)
    rows = recs.commands.shape[0] * recs.commands.shape[1]
    assert counted.steps == 2 * rows, "what is asked for twice is simulated once"
    assert sum(heard) == counted.steps * arm.substeps


@pytest.mark.parametrize("declared", [True, False])
def test_joints_are_not_pushed_about_by_the_noise_of_their_encoders(arm, arm_episodes, monkeypatch, declared):
    """A replay of a noisy recording lies nearer its true world than one that hears the noise; least without a word."""
    file = arm.file if declared else arm.file.model_copy(update={"noise": None})
    scene = replace(arm, file=file)
    noisy, true = (recordings(arm, arm_episodes((), count=4, noise=some)) for some in (True, False))
    begin = starts(scene, true)
    quiet = replay(Replayer(scene), noisy, begin, [()])[0]
    monkeypatch.setattr(module, "Observer", lambda told, joint_noise: Observer(told))
    heard = replay(Replayer(scene), noisy, begin, [()])[0]
    off = [np.nanmean(np.abs(r["joint_position"] - true.readings["joint_position"])) for r in (quiet, heard)]
    assert 0 < off[0] < (0.5 if declared else 0.95) * off[1]


def test_contact_too_is_replayed_as_recorded(hand, squeezes):
    recs, begin = squeezes
    true = rollout(hand, recs.commands, begin.qpos, begin.qvel, [()] * 2)
    again = replay(Replayer(hand), replace(recs, readings=true.readings), begin, [()])[0]
    for channel, values in true.readings.items():
        np.testing.assert_allclose(again[channel], values, atol=CLOSE[channel])


def test_the_observer_pulls_a_wrong_start_back_at_its_gain(hand, plain_recordings):
    rows, gain = 30, Observer({}).free_gain
    qpos, qvel = at_rest(hand, 1)
    joints = np.repeat(qpos[:, None, hand.joint_qpos], rows, axis=1)
    still = rollout(hand, joints, qpos, qvel, [()]).readings
    recs = plain_recordings(commands=joints, **still)
    at, off = hand.object_qpos, 0.004
    wrong = qpos.copy()
    wrong[:, at] += off
    begin = Starts(np.zeros(1, int), wrong, qvel, wrong, qvel, *[np.zeros((1, 0))] * 2)
    error = replay(Replayer(hand), recs, begin, [()])[0]["object_pose"][0, :, 0] - still["object_pose"][0, :, 0]
    # Nothing but the support touches the object, so each row leaves 1 - gain of the error; the table's friction may
    # move it by less than 1 % of the offset.
    np.testing.assert_allclose(error, off * (1 - gain) ** np.arange(rows), atol=0.01 * off)


@pytest.mark.parametrize("steps", [3.0, 5.6])
def test_a_latency_leaves_as_much_noise_in_the_replay_of_a_resting_object(hand, plain_recordings, planted, steps):
    """Pulled by readings that are late, it would swing about its recording: 1.3 times as far at 3 rows, 1.5 at 6."""
    rows, count, sd = 200, 16, 0.001
    qpos, qvel = at_rest(hand, 1)
    joints = np.repeat(np.repeat(qpos[:, None, hand.joint_qpos], rows, axis=1), count, axis=0)
    still = rollout(hand, joints[:1], qpos, qvel, [()]).readings
    noisy = {n: np.repeat(v, count, axis=0) for n, v in still.items()}
    noisy["object_pose"][..., :2] += sd * np.random.default_rng(1).standard_normal((count, rows, 2))
    recs = plain_recordings(commands=joints, **noisy)
    begin = Starts(
        *(np.repeat(v, count, axis=0) for v in (np.zeros(1, int), qpos, qvel, qpos, qvel, *[np.zeros((1, 0))] * 2))
    )
    world = planted("pose_latency", latency_s=steps / hand.file.rate_hz)
    found = [replay(Replayer(hand), recs, begin, [some])[0]["object_pose"] for some in ((), world)]
    off = [np.std((p - noisy["object_pose"])[:, 20:180, :2].reshape(count, -1, 4, 2).mean(2)) for p in found]
    # The first rows of the replay come before what is late: what is left out at both ends is the same. Block means of
    # 640 values know their spread to 3 %.
    assert off[1] == pytest.approx(off[0], rel=0.03)


def test_a_gap_in_the_recording_pulls_nothing(hand, plain_recordings):
    rows = 20
    qpos, qvel = at_rest(hand, 1)
    joints = np.repeat(qpos[:, None, hand.joint_qpos], rows, axis=1)
    free = rollout(hand, joints, qpos, qvel, [()]).readings
    recs = plain_recordings(commands=joints, **{n: np.full_like(v, np.nan) for n, v in free.items()})
    again = replay(
        Replayer(hand), recs, Starts(np.zeros(1, int), qpos, qvel, qpos, qvel, *[np.zeros((1, 0))] * 2), [()]
    )[0]
    for channel, values in free.items():
        np.testing.assert_allclose(again[channel], values, atol=1e-12)


def test_tosses_start_at_rows_of_their_own(cube, played):
    rows = np.array([3, 11, 0])
    recs = recordings(cube, played(cube, count=3, duration_s=0.4, noise=False))
    begin = starts(cube, recs)
    true = rollout(cube, recs.commands, begin.qpos0, begin.qvel0, [()] * 3, keep_state=True)
    pick = np.arange(3), rows
    begin = replace(begin, rows=rows, qpos=true.qpos[pick], qvel=true.qvel[pick])
    again = replay(Replayer(cube), replace(recs, readings=true.readings), begin, [()])[0]["object_pose"]
    for e, row in enumerate(rows):
        assert np.isnan(again[e, :row]).all()
        # Open loop from the same state with a cold solver: the first contact's last places differ.
        np.testing.assert_allclose(again[e, row:], true.readings["object_pose"][e, row:], atol=1e-6)


def test_force_sensing_alone_needs_no_simulation(hand, squeezes, planted):
    recs, begin = squeezes
    gain = planted("tactile_gain", gain=1.5)
    bias = planted("tactile_bias", hand.file.fingertips[1], bias_N=tuple(np.arange(15) / 10))
    mass = planted("object_mass", mass_scale=1.3)
    some = [(), gain, bias, mass, (*mass, *gain)]
    steps: list[int] = []
    found = replay_all(Replayer(hand, 1, steps.append), recs, begin, some)
    # Two different worlds, each simulated once.
    assert sum(steps) == 2 * len(recs) * recs.commands.shape[1] * hand.substeps
    for quick, slow in zip(found, replay(Replayer(hand), recs, begin, some), strict=True):
        for channel in recs.readings:
            np.testing.assert_allclose(quick[channel], slow[channel], atol=CLOSE[channel])
    assert np.array_equal(found[1]["fingertip_force"], 1.5 * found[0]["fingertip_force"])
    added = found[2]["fingertip_force"] - found[0]["fingertip_force"]
    np.testing.assert_allclose(added[:, :, 1], np.broadcast_to([0.3, 0.4, 0.5], added[:, :, 1].shape), atol=1e-12)
    assert not np.delete(added, 1, axis=2).any()


def test_sensing_effects_act_in_one_order(hand, squeezes, planted):
    recs, begin = squeezes
    both = (*planted("tactile_gain", gain=1.5), *planted("tactile_bias", bias_N=tuple(np.arange(15) / 10)))
    simulated = replay(Replayer(hand), recs, begin, [both])[0]["fingertip_force"]
    for some in (both, both[::-1]):
        found = replay_all(Replayer(hand), recs, begin, [some])[0]["fingertip_force"]
        np.testing.assert_allclose(found, simulated, atol=CLOSE["fingertip_force"])


@pytest.mark.parametrize(
    ("name", "value", "needs"),
    [
        ("tactile_gain", {"gain": 1.2}, False),
        ("pose_latency", {"latency_s": 0.03}, True),
        ("object_mass", {"mass_scale": 1.2}, True),
        ("actuation_delay", {"delay_s": 0.01}, True),
    ],
)
def test_what_the_observer_follows_needs_a_simulation(planted, name, value, needs):
    assert needs_simulation(planted(name, **value)) is needs


def test_a_replay_does_not_see_threads(hand, squeezes, variants):
    recs, begin = squeezes
    one, three = (replay(Replayer(hand, threads), recs, begin, variants) for threads in (1, 3))
    for a, b in zip(one, three, strict=True):
        assert all(np.array_equal(a[c], b[c], equal_nan=True) for c in a)


def test_a_replay_does_not_see_its_batch(hand, squeezes, variants, monkeypatch):
    recs, begin = squeezes
    together = replay(Replayer(hand), recs, begin, variants)
    alone = replay(Replayer(hand), recs.take([1]), begin.take(np.array([1])), variants[2:3])[0]
    monkeypatch.setattr(module, "BATCH", 1)
    apart = replay(Replayer(hand), recs, begin, variants)
    for channel, close in CLOSE.items():
        np.testing.assert_allclose(together[2][channel][1:], alone[channel], atol=close)
        for a, b in zip(together, apart, strict=True):
            np.testing.assert_allclose(a[channel], b[channel], atol=close)
        # The control: the variants differ by far more than that.
        assert np.abs(together[2]["object_pose"] - together[0]["object_pose"]).max() > 10 * CLOSE["object_pose"]


def test_the_order_of_variants_is_kept(hand, squeezes, variants):
    recs, begin = squeezes
    forth, back = (replay_all(Replayer(hand), recs, begin, some) for some in (variants, variants[::-1]))
    for a, b in zip(forth, back[::-1], strict=True):
        assert np.array_equal(a["object_pose"], b["object_pose"])
    assert not np.array_equal(forth[0]["joint_position"], forth[1]["joint_position"])


def test_states_are_kept_on_request(arm, arm_episodes):
    recs = recordings(arm, arm_episodes(count=2, rows=40, noise=False))
    found = replay(Replayer(arm), recs, starts(arm, recs), [()], keep_state=True)[0]
    assert np.array_equal(found["qpos"][:, :, arm.joint_qpos], found["joint_position"])
