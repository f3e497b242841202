"""What repeats of a motion differ by beyond sensor noise: measured, declared, or said to be unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.deviation import SlowDeviation, unshaped
from candata.gap.data.rounding import joint_step
from candata.gap.preparation import posed
from candata.gap.replay.replayer import Replayer
from candata.schema.effect import EffectSetting
from candata.schema.scene import Noise, Repeatability

#: Standard deviation of the servos' gain from one run to the next.
VARIES = 0.15


def runs(arm_episodes, count: int, gain: float = 1.0, varies: float = 0.0, seed: int = 5, delay_s: float = 0.0):
    """Return the same four motions `count` times; the servos' gain differs from one run of a motion to the next."""
    rng, episodes = np.random.default_rng(seed), []
    for r in range(count):
        for m in range(4):
            scale = gain * (1 + varies * rng.standard_normal())
            effects = (EffectSetting(name="servo_gain", parameters={"kp_scale": scale}),)
            if delay_s:
                effects = (*effects, EffectSetting(name="actuation_delay", parameters={"delay_s": delay_s}))
            played = arm_episodes(effects, count=4, seed=1, noise=False)[m]
            joints = played["joint_position"] + rng.normal(0, 0.001, played["joint_position"].shape)
            meta = played.meta.model_copy(update={"id": f"{played.meta.id}-{r}"})
            episodes.append(replace(played, meta=meta, arrays=dict(played.arrays) | {"joint_position": joints}))
    return episodes


def problem_of(as_dataset, scene, episodes, **options):
    return posed(as_dataset(episodes), Replayer(scene), 0, None, **options).problem


@pytest.fixture(scope="module")
def varying(arm, as_dataset, arm_episodes):
    return problem_of(as_dataset, arm, runs(arm_episodes, 3, varies=VARIES))


def test_the_floor_holds_what_repeats_differ_by(varying):
    """Without it, every run whose gain differs is a gap."""
    assert varying.recs.slow
    assert varying.score.loss(varying.nominal).mean() < 2.0
    plain = replace(varying, recs=replace(varying.recs, slow=()))
    level = plain.library.nulls(plain.noise)
    alone = np.nanstd(replace(varying.library, recs=plain.recs, memo={}).nulls(plain.noise))
    assert np.nanstd(level) > 3 * alone
    assert any("repeats of a motion differ in joint position by up to" in note for note in varying.recs.notes)


def test_repeats_that_differ_by_noise_alone_change_nothing(arm, as_dataset, arm_episodes):
    problem = problem_of(as_dataset, arm, runs(arm_episodes, 3))
    assert problem.recs.slow == ()
    assert not any("repeats of a motion" in note for note in problem.recs.notes)


def test_runs_of_one_setting_are_no_gap(arm, judge, arm_episodes):
    assert judge(arm, runs(arm_episodes, 3, varies=VARIES)).report.verdict == "no_gap"


def test_a_cause_larger_than_what_repeats_differ_by_is_named(arm, judge, arm_episodes):
    report = judge(arm, runs(arm_episodes, 3, gain=0.5, varies=0.05)).report
    assert [e.name for e in report.effects] == ["servo_gain"]
    assert report.effects[0].parameters["kp_scale"].value == pytest.approx(0.5, rel=0.1)


def test_without_repeats_the_floor_is_said_to_be_a_lower_bound(arm, as_dataset, arm_episodes):
    """Where the scene declares nothing; what it declares is a floor."""
    silent = replace(arm, file=arm.file.model_copy(update={"noise": None}))
    notes = problem_of(as_dataset, silent, arm_episodes()).recs.notes
    assert sum("a lower bound" in note and "would tell it to about" in note for note in notes) == 1
    assert not any("a lower bound" in note for note in problem_of(as_dataset, arm, arm_episodes()).recs.notes)


def test_declared_repeatability_is_the_least_floor(arm, as_dataset, arm_episodes, varying):
    declared = Repeatability(joint_position=0.02)
    scene = replace(arm, file=arm.file.model_copy(update={"repeatability": declared}))
    alone = problem_of(as_dataset, scene, arm_episodes())
    assert np.allclose(alone.recs.slow[0].sd, 0.02)
    assert alone.score.sigma.mean() > 3 * problem_of(as_dataset, arm, arm_episodes()).score.sigma.mean()
    with_repeats = problem_of(as_dataset, scene, runs(arm_episodes, 3, varies=VARIES)).recs.slow
    variance = sum(part.variance for part in with_repeats)
    assert (variance >= 0.02**2 - 1e-12).all()
    assert (variance >= varying.recs.slow[0].variance - 1e-12).all()


def test_a_scene_without_new_fields_keeps_its_digest(arm):
    text = arm.file.model_dump_json()
    assert "repeatability" not in text
    assert "joint_step" not in text
    assert Noise.model_validate_json(Noise(joint_step=0.001).model_dump_json()).joint_step == 0.001


@pytest.mark.parametrize("step", [0.00153, 0.0005])
def test_the_step_of_an_encoder_is_found_in_the_data(arm, as_dataset, arm_episodes, step):
    episodes = [
        replace(e, arrays=dict(e.arrays) | {"joint_position": np.round(e["joint_position"] / step) * step})
        for e in arm_episodes(noise=False)
    ]
    problem = problem_of(as_dataset, arm, episodes)
    assert problem.noise.joint_step == pytest.approx((step, step), rel=0.01)
    assert problem.score.loss(problem.nominal).mean() < 1.5


def test_readings_that_are_not_rounded_have_no_step(arm_episodes):
    readings = {"joint_position": np.stack([e["joint_position"] for e in arm_episodes()])}
    assert (joint_step(readings) == 0).all()


def test_deviations_are_as_large_and_last_as_long_as_asked(rng):
    moved = unshaped(np.full((400, 300, 2), 0.02), np.array([0.05, 0.5])).drawn(100.0, rng)
    assert moved.std((0, 1)) == pytest.approx([0.02, 0.02], rel=0.1)
    later = (moved[:, 10:] * moved[:, :-10]).mean((0, 1)) / moved.var((0, 1))
    assert later == pytest.approx(np.exp(-0.1 / np.array([0.05, 0.5])), abs=0.06)


def test_deviations_have_the_shapes_that_were_seen(rng):
    shape = np.sin(np.arange(50) / 5)[None, None, :, None]
    slow = SlowDeviation(np.zeros((300, 50, 1)), np.ones(1), shape, np.zeros(300, int), np.arange(300))
    drawn = slow.drawn(100.0, rng)[..., 0]
    assert np.linalg.matrix_rank(drawn) == 1
    assert drawn.std(0) == pytest.approx(np.abs(shape[0, 0, :, 0]), rel=0.15)
    assert slow.variance == pytest.approx(np.broadcast_to(shape[0] ** 2, (300, 50, 1)))


def test_copies_of_a_motion_share_a_deviation_within_a_recording_alone(rng):
    slow = unshaped(np.full((4, 50, 1), 0.01), np.array([0.2]), np.array([0, 0, 1, 1]))
    moved = slow.copies(2).drawn(100.0, rng)
    assert (moved[0] == moved[1]).all()
    assert not (moved[0] == moved[2]).all()
    assert not (moved[0] == moved[4]).all()
