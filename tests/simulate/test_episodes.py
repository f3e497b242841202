"""Episodes follow from their jobs alone: not from their neighbours, nor from threads."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from candata.datasets import content_hash
from candata.errors import DataError
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate.episodes import EpisodeJob, make_episodes, tried_episodes

POLICIES = ("grasp_lift_shake", "free_sweep", "push")
EFFECTS = ((), (EffectSetting(name="pose_latency", parameters={"latency_s": 0.03}),))
JOBS = [EpisodeJob(f"e{i}", i, POLICIES[i % 3], 4, EFFECTS[i % 2]) for i in range(6)]


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
    hidden = make_episodes(hand, [EpisodeJob("w", 0, "push", 4, EFFECTS[1], hidden=True)], duration_s=0.1)[0]
    assert hidden.meta.seed is None
    assert hidden.meta.effects is None


#: Explicit steps of 10 ms under a servo's damping that asks for a twentieth of that.
STIFF = """<mujoco><option timestep="0.01" integrator="Euler"/><worldbody><body><joint name="j" axis="0 0 1"/>
  <geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass=".4"/></body></worldbody>
  <actuator><position name="j" joint="j" kp="15" kv="KV" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.fixture
def stiff(tmp_path):
    """Make a scene of one joint whose servo has a velocity gain."""

    def make(kv: float):
        (tmp_path / "scene.xml").write_text(STIFF.replace("KV", f"{kv}"))
        (tmp_path / "scene.yaml").write_text("model: scene.xml\nrate_hz: 100\njoints: [j]\nactuators: [j]\n")
        return load_scene(tmp_path / "scene.yaml")

    return make


def test_an_unstable_simulation_is_an_error_that_names_it(stiff, tmp_path, capfd, monkeypatch):
    """What MuJoCo gives up begins anew from the model's own state: nothing that a dataset should hold."""
    monkeypatch.chdir(tmp_path)
    before = mujoco.MjLogConfig.get()
    fine, wild = (
        EffectSetting(name="servo_damping", parameters={"kv_scale": 1.0}),
        EffectSetting(name="servo_damping", parameters={"kv_scale": 8.0}),
    )
    scene = stiff(1.0)
    assert len(make_episodes(scene, [EpisodeJob("a", 0, "free_sweep", 1, (fine,))], duration_s=0.5)) == 1
    jobs = [EpisodeJob("a", 0, "free_sweep", 1, (fine,)), EpisodeJob("b", 1, "free_sweep", 1, (wild,))]
    with pytest.raises(DataError, match="unstable") as caught:
        make_episodes(scene, jobs, duration_s=0.5)
    assert caught.value.where.episode == "b"
    assert "with servo_damping" in caught.value.found
    assert "10 ms" in caught.value.expected
    made, fails = tried_episodes(scene, jobs, duration_s=0.5)
    assert len(made) == 2
    assert np.isnan(fails[0])
    assert fails[1] < 0.5
    # MuJoCo would print each warning and write it to a file where the user stands.
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert "WARNING" not in "".join(capfd.readouterr())
    after = mujoco.MjLogConfig.get()
    assert (after.logto_console, after.logto_file) == (before.logto_console, before.logto_file)


def test_what_is_withheld_stays_so_in_an_error(stiff):
    wild = EffectSetting(name="servo_damping", parameters={"kv_scale": 8.0})
    with pytest.raises(DataError, match="unstable") as caught:
        make_episodes(stiff(1.0), [EpisodeJob("b", 1, "free_sweep", 1, (wild,), hidden=True)], duration_s=0.5)
    assert "servo_damping" not in str(caught.value)


def test_a_simulation_that_is_unstable_without_any_effect_says_so(stiff):
    with pytest.raises(DataError, match="unstable") as caught:
        make_episodes(stiff(12.0), [EpisodeJob("b", 1, "free_sweep", 1)], duration_s=0.5)
    assert "without any effect" in caught.value.found
