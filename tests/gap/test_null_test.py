"""No name out of nothing: what gains on recordings of the scene itself is no cause, a planted cause is."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.validation.null_test import null_gains, surpasses_nulls
from candata.scenes import load_scene
from candata.schema.episode import Episode, EpisodeMeta

RATE_HZ, STEPS, ROWS, EPISODES = 80.0, 5, 120, 10
NOISE_M, NOISE_RAD = 0.0008, 0.006
XML = """<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/><worldbody>
  <geom name="table" type="plane" size="1 1 .1"/>
  <body name="block" pos="0 0 .025"><freejoint/><geom type="box" size=".02 .02 .025" mass=".2"/></body>
  <body pos=".1 0 .2"><joint name="a" axis="0 1 0" damping=".02" armature=".001"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.08" size=".007" mass=".03" contype="0" conaffinity="0"/>
    <geom name="tip" type="sphere" pos="0 0 -.09" size=".01" mass=".01"/></body></worldbody>
  <actuator><position name="a" joint="a" kp="2" kv=".06"/></actuator></mujoco>"""
ROLES = f"""model: scene.xml
rate_hz: {RATE_HZ:g}
object: block
joints: [a]
actuators: [a]
fingertips: [tip]
support: table
noise: {{object_pose: [{NOISE_M}, {NOISE_RAD}], joint_position: 0.001, fingertip_force: 0.02}}
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("still")
    (folder / "scene.xml").write_text(XML)
    (folder / "scene.yaml").write_text(ROLES)
    return load_scene(folder / "scene.yaml")


def still(index: int) -> Episode:
    """A finger that moves beside a block at rest, stepped by MuJoCo alone."""
    rng = np.random.default_rng([7, index])
    model = mujoco.MjModel.from_xml_string(XML)
    data, rows = mujoco.MjData(model), []
    pace, size = rng.uniform(4, 9), rng.uniform(0.2, 0.4)
    for k in range(-40, ROWS):
        command = size * np.sin(pace * max(k, 0) / RATE_HZ)
        data.ctrl[:] = command
        if k >= 0:
            rows.append((data.qpos.copy(), command))
        mujoco.mj_step(model, data, STEPS)
    qpos = np.array([q for q, _ in rows])
    turn = np.concatenate([np.ones((ROWS, 1)), NOISE_RAD / 2 * rng.standard_normal((ROWS, 3))], axis=1)
    pose = np.concatenate([qpos[:, :3] + NOISE_M * rng.standard_normal((ROWS, 3)), turn], axis=1)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    arrays = {
        "time_ns": np.round(np.arange(ROWS) * 1e9 / RATE_HZ).astype(np.int64),
        "action": np.array([[command] for _, command in rows]),
        "joint_position": qpos[:, 7:] + 0.001 * rng.standard_normal((ROWS, 1)),
        "object_pose": pose,
        "fingertip_force": 0.02 * rng.standard_normal((ROWS, 1, 3)),
    }
    meta = EpisodeMeta(
        id=f"e{index}",
        source="real",
        rate_hz=RATE_HZ,
        joint_names=("a",),
        actuator_names=("a",),
        fingertip_names=("tip",),
    )
    return Episode(meta, arrays)


def test_an_effect_that_only_changes_how_noise_is_followed_is_not_named(scene, judge):
    found = judge(scene, [still(i) for i in range(EPISODES)], only=("pose_latency", "object_size", "pose_bias"))
    assert found.report.verdict == "no_gap"
    assert found.report.effects == ()


def test_a_late_tracker_gains_as_much_on_null_recordings_of_a_block_at_rest(scene, judge):
    recs = recordings(scene, [still(i) for i in range(EPISODES)])
    problem = _problem(Replayer(scene), recs, Streams(0), None, lambda stage: None)
    late = (candidate("pose_latency", scene), np.array([0.05]))
    with_it, without = (problem.residuals([problem.setting(some)])[0] for some in ((late,), ()))
    gain = problem.score.loss(without) - problem.score.loss(with_it)
    nulls = null_gains(problem, (), (late,))
    # It does gain, by what the observer no longer follows, in most episodes; on nulls too.
    assert gain.mean() > 1.5 * gain.std() / np.sqrt(EPISODES)
    assert nulls.mean() == pytest.approx(gain.mean(), abs=0.008)
    assert not surpasses_nulls(problem, (late,), 0, gain)


def test_a_planted_cause_gains_beyond_what_nulls_show(arm, arm_episodes, planted):
    cause = planted("joint_damping", damping_Nms_rad=0.001)
    recs = recordings(arm, arm_episodes(cause, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    damped = (candidate("joint_damping", arm), np.array([0.001]))
    own, nominal = (problem.score.loss(problem.residuals([problem.setting(s)])[0]) for s in ((damped,), ()))
    gain = nominal - own
    assert 0 < gain.mean() < 1  # as faint as a null loses in all: else it would pass unasked
    assert surpasses_nulls(problem, (damped,), 0, gain)
