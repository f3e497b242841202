"""Episodes follow from their jobs alone: not from their neighbours, nor from threads."""

from __future__ import annotations

import numpy as np
import pytest

from candata.datasets import content_hash
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate.episodes import Job, make_episodes

POLICIES = ("grasp_lift_shake", "free_sweep", "push")
EFFECTS = ((), (EffectSetting(name="pose_latency", parameters={"latency_s": 0.03}),))
JOBS = [Job(f"e{i}", i, POLICIES[i % 3], 4, EFFECTS[i % 2]) for i in range(6)]


@pytest.fixture(scope="module")
def hand():
    return load_scene("xhand_tabletop")


@pytest.fixture(scope="module")
def together(hand):
    return make_episodes(hand, JOBS, duration_s=0.6, noise=hand.file.noise)


def test_an_episode_does_not_see_its_batch(hand, together):
    for some in (JOBS[:1], JOBS[1:2], JOBS[4:], JOBS[::-1]):
        for job, episode in zip(some, make_episodes(hand, some, duration_s=0.6, noise=hand.file.noise), strict=True):
            assert content_hash(episode) == content_hash(together[job.index])


def test_an_episode_does_not_see_threads(hand, together):
    again = make_episodes(hand, JOBS, duration_s=0.6, noise=hand.file.noise, threads=3)
    assert list(map(content_hash, again)) == list(map(content_hash, together))


def test_noise_is_as_large_as_declared(hand, together):
    noise = hand.file.noise
    plain = make_episodes(hand, JOBS, duration_s=0.6)
    error = {
        channel: np.concatenate([(a[channel] - b[channel]).ravel() for a, b in zip(together, plain, strict=True)])
        for channel in ("joint_position", "fingertip_force")
    }
    # 4320 values: their standard deviation is known to 1.1 % (1 sd).
    assert error["joint_position"].std() == pytest.approx(noise.joint_position, rel=0.05)
    # Rounding to steps of q adds q^2 / 12 to the variance.
    rounded = np.hypot(noise.fingertip_force, noise.force_step / np.sqrt(12))
    assert error["fingertip_force"].std() == pytest.approx(rounded, rel=0.1)
    step = np.concatenate([e["fingertip_force"].ravel() for e in together]) / noise.force_step
    np.testing.assert_allclose(step, np.round(step), atol=1e-4)


def test_noise_does_not_change_the_plan(hand, together):
    plain = make_episodes(hand, JOBS, duration_s=0.6)
    for a, b in zip(together, plain, strict=True):
        assert np.array_equal(a["action"], b["action"])


def test_an_episode_says_who_and_what(hand, together):
    meta = together[1].meta
    assert (meta.task, meta.seed, meta.effects, meta.scene) == ("free_sweep", 4, EFFECTS[1], "xhand_tabletop")
    hidden = make_episodes(hand, [Job("w", 0, "push", 4, EFFECTS[1], hidden=True)], duration_s=0.1)[0]
    assert hidden.meta.seed is None
    assert hidden.meta.effects is None
