"""How servos answer: planted lags come back, and what does not move is not judged."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import DataError
from candata.gap.data.recordings import Recordings
from candata.scenes import load_scene
from candata.scenes.servo import write_servo_scene
from candata.schema.effect import EffectSetting
from candata.simulate import rollout

RATE_HZ, NATURAL_HZ = 30.0, 2.0
#: A critically damped servo follows a slow command 2 / w behind.
OWN_LAG_S = 2 / (2 * np.pi * NATURAL_HZ)
NAMES = ("quick", "late", "weak", "still")


@pytest.fixture(scope="module")
def servo_response(loaded):
    return loaded("g1_inspire_pick/servo_response.py")


@pytest.fixture(scope="module")
def servos(tmp_path_factory):
    ranges = np.tile([-1.0, 1.0], (len(NAMES), 1))
    return load_scene(write_servo_scene(tmp_path_factory.mktemp("servo"), NAMES, ranges, RATE_HZ, NATURAL_HZ))


@pytest.fixture(scope="module")
def recorded(servos):
    """The function that records reaches of all joints but one in a world."""

    def make(effects=(), count: int = 8, rows: int = 180) -> Recordings:
        rng = np.random.default_rng(4)
        marks = np.cumsum(rng.normal(0, 0.3, (count, rows // 15 + 1, len(NAMES))), axis=1)
        commands = np.stack(
            [[np.interp(np.arange(rows), 15 * np.arange(len(m)), m[:, j]) for j in range(len(NAMES))] for m in marks]
        ).transpose(0, 2, 1)
        commands[..., 3] = 0.4 + 0.001 * rng.standard_normal(commands.shape[:2])
        qpos = commands[:, 0]
        played = rollout(servos, commands, qpos, np.zeros_like(qpos), [effects] * count)
        noisy = played.readings["joint_position"] + 0.002 * rng.standard_normal(commands.shape)
        ids = tuple(map(str, range(count)))
        return Recordings(ids, ids, commands, {"joint_position": noisy}, np.full(count, rows), False)

    return make


def test_lag_bandwidth_and_gain_of_a_servo_come_back(servo_response, servos, recorded):
    found = {f.joint: f for f in servo_response.servo_responses(servos, recorded(), np.random.default_rng(0))}
    for name in NAMES[:3]:
        one = found[name]
        assert one.identifiable
        assert one.lag_low_s <= OWN_LAG_S <= one.lag_high_s
        # Lags are tried in steps of 8 ms, bandwidths in steps of a tenth.
        assert one.lag_s == pytest.approx(OWN_LAG_S, abs=0.008)
        assert one.bandwidth_hz == pytest.approx(NATURAL_HZ * servo_response.HALF_POWER, rel=0.11)
        assert one.gain == pytest.approx(1, abs=0.02)
        assert one.r2 > 0.99


def test_one_late_and_one_weak_joint_are_told_apart(servo_response, servos, recorded):
    world = (
        EffectSetting(name="actuation_delay", element="late", parameters={"delay_s": 0.1}),
        EffectSetting(name="servo_gain", element="weak", parameters={"kp_scale": 0.5}),
    )
    found = {f.joint: f for f in servo_response.servo_responses(servos, recorded(world), np.random.default_rng(0))}
    assert found["quick"].delay_s < 0.02
    assert found["late"].delay_s == pytest.approx(0.1, abs=0.017)  # two steps of the delays that are tried
    assert found["late"].lag_s == pytest.approx(OWN_LAG_S + 0.1, abs=0.012)
    # A servo of half the stiffness lags kv / kp = twice as long, by no delay.
    assert found["weak"].lag_s == pytest.approx(2 * OWN_LAG_S, rel=0.1)
    assert found["weak"].bandwidth_hz < 0.75 * found["quick"].bandwidth_hz


def test_a_joint_whose_command_hardly_moves_is_not_judged(servo_response, servos, recorded):
    still = servo_response.servo_responses(servos, recorded(), np.random.default_rng(0))[3]
    assert not still.identifiable
    assert still.why_not == "its command hardly moves"


def test_a_joint_that_does_not_follow_is_not_judged(servo_response, servos, recorded):
    recs = recorded()
    recs.readings["joint_position"][..., 0] = np.random.default_rng(1).normal(size=recs.commands.shape[:2])
    assert (
        servo_response.servo_responses(servos, recs, np.random.default_rng(0))[0].why_not
        == "it does not follow its command"
    )


def test_gaps_and_short_episodes_are_left_out(servo_response, servos, recorded):
    recs = recorded()
    recs.readings["joint_position"][:, 50:60, 1] = np.nan
    recs.lengths[0] = 100
    recs.readings["joint_position"][0, 100:] = np.nan
    quick = servo_response.servo_responses(servos, recs, np.random.default_rng(0))[0]
    assert quick.lag_s == pytest.approx(OWN_LAG_S, abs=0.008)


def test_too_few_episodes_and_scenes_without_servos_are_refused(servo_response, servos, recorded):
    with pytest.raises(DataError, match="nothing to tell servos from"):
        servo_response.servo_responses(servos, recorded(count=3), np.random.default_rng(0))
    with pytest.raises(DataError, match="0 driven joints"):
        servo_response.servo_responses(load_scene("cube_toss"), recorded(), np.random.default_rng(0))
