"""The recordings of the other engine keep candata's conventions: sign, frames, timing, masses, servos."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from candata.policies import policy
from candata.rotation import exp, rotate
from candata.schema.effect import EffectSetting
from candata.simulate import rollout

pybullet = pytest.importorskip("pybullet", reason="the bench extra is not installed")
FOLDER = Path(__file__).resolve().parents[2] / "examples/other_engine"
G = 9.81


@pytest.fixture(scope="module")
def example():
    """The modules of the example."""
    sys.path.insert(0, str(FOLDER))
    yield {name: importlib.import_module(name) for name in ("bodies", "bullet", "record")}
    sys.path.remove(str(FOLDER))


@pytest.fixture(scope="module")
def scene(example, tmp_path_factory):
    return example["record"].write_scene(tmp_path_factory.mktemp("other"))


@pytest.fixture
def client():
    from pybullet_utils.bullet_client import BulletClient

    made = BulletClient(connection_mode=pybullet.DIRECT)
    made.setGravity(0, 0, -G)
    yield made
    made.disconnect()


def plan_of(scene, task: str, duration_s: float = 1.5):
    return policy(task).plan(scene, np.random.default_rng(3), duration_s)


def nominal(scene, plan, *effects: EffectSetting) -> dict[str, np.ndarray]:
    """What MuJoCo reads for the same commands, after the same settling."""
    settle = round(plan.settle_s * scene.file.rate_hz)
    commands = np.concatenate([np.repeat(plan.commands[:1], settle, axis=0), plan.commands])[None]
    played = rollout(scene, commands, plan.qpos[None], plan.qvel[None], [effects], settle=settle)
    return {name: value[0, settle:] for name, value in played.readings.items()}


def test_a_ball_resting_on_an_upturned_fingertip_reads_minus_its_weight_along_world_z(example, client):
    flat = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.02, 0.02, 0.02])
    ball = client.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.01)
    fingertip = client.createMultiBody(0, flat)
    falling = client.createMultiBody(0.2, ball, basePosition=[0, 0, 0.0301])
    for _ in range(480):
        client.stepSimulation()
    force = example["bullet"].force_on(client, fingertip, -1, falling)
    # Solver residual: well below a tenth of a per cent of the weight.
    assert force == pytest.approx([0, 0, -0.2 * G], abs=2e-3)


def test_friction_has_the_sign_of_the_force_on_the_fingertip(example, client):
    """On a slope the friction of the ball's box drags the fingertip down the slope, and all forces sum to -m g."""
    tilt = exp(np.array([0.0, 0.2, 0.0]))
    turn = [*tilt[1:], tilt[0]]
    slab = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.2, 0.2, 0.02])
    cube = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.02, 0.02, 0.02])
    fingertip = client.createMultiBody(0, slab, baseOrientation=turn)
    above = rotate(tilt, np.array([0.0, 0.0, 0.0401]))
    resting = client.createMultiBody(0.2, cube, basePosition=above.tolist(), baseOrientation=turn)
    for body in (fingertip, resting):
        client.changeDynamics(body, -1, lateralFriction=1.0)
    readings = []
    for _ in range(480):
        client.stepSimulation()
        readings.append(example["bullet"].force_on(client, fingertip, -1, resting))
    # Bullet corrects penetration by impulses that come and go: the mean of a second is what must balance.
    assert np.mean(readings[240:], axis=0) == pytest.approx([0, 0, -0.2 * G], abs=0.02)


def sweeps(plan) -> slice:
    """Rows before the targets first jump: at the 28 rad/s of a jump half a millisecond is 14 mrad."""
    jumps = np.abs(np.diff(plan.commands, axis=0)).max(axis=1) > 0.2
    return slice(0, int(np.argmax(jumps)) if jumps.any() else None)


def test_free_joints_move_alike_in_both_engines(example, scene):
    """Masses, inertias, axes, servos and the timing of the commands: a command one row late would be 20 mrad off."""
    plan = plan_of(scene, "free_sweep")
    rows = sweeps(plan)
    assert rows.stop > 60
    ours = nominal(scene, plan)["joint_position"][rows]
    theirs = example["record"].play(plan, scene, {})["joint_position"][rows]
    # Measured 0.9 mrad at most: both integrate to first order.
    assert np.abs(ours - theirs).max() < 4e-3
    assert np.abs(ours[1:] - theirs[:-1]).max() > 2e-2


def test_hidden_damping_is_damping_in_both_engines(example, scene):
    plan, hidden = plan_of(scene, "free_sweep"), example["record"].HIDDEN["damping"]
    rows = sweeps(plan)
    damped = EffectSetting(name="joint_damping", parameters={"damping_Nms_rad": hidden["damping_nms_rad"]})
    theirs = example["record"].play(plan, scene, hidden)["joint_position"][rows]
    assert np.abs(nominal(scene, plan, damped)["joint_position"][rows] - theirs).max() < 4e-3  # as without damping
    assert np.abs(nominal(scene, plan)["joint_position"][rows] - theirs).max() > 2e-2


def test_a_held_box_weighs_the_same_in_both_engines_and_frames_agree(example, scene):
    plan = plan_of(scene, "squeeze")
    ours, theirs = nominal(scene, plan), example["record"].play(plan, scene, {})
    held = slice(60, 95)
    mean = [f["fingertip_force"][held].mean(0) for f in (ours, theirs)]
    # Contact models differ; a wrong sign or frame would turn a force of 1 to 2 N round.
    for a, b in zip(*mean, strict=True):
        assert a @ b > 0.7 * np.linalg.norm(a) * np.linalg.norm(b)
    assert np.linalg.norm(theirs["object_pose"][0, :3] - ours["object_pose"][0, :3]) < 1e-3
    assert np.allclose(np.linalg.norm(theirs["object_pose"][:, 3:], axis=1), 1)
    assert theirs["object_pose"][0, 3] > 0.99, "w comes first"


def test_the_force_of_a_row_belongs_to_the_step_before_it(example, scene):
    """Contact begins in both engines within two rows."""
    plan = plan_of(scene, "squeeze", 1.5)
    ours, theirs = nominal(scene, plan), example["record"].play(plan, scene, {})
    first = [np.argmax(np.abs(f["fingertip_force"]).sum((1, 2)) > 0.3) for f in (ours, theirs)]
    assert abs(int(first[0]) - int(first[1])) <= 2
    assert first[0] > 5


def test_what_is_hidden_changes_the_recording(example, scene):
    plan = plan_of(scene, "grasp_lift_shake", 1.0)
    play, hidden = example["record"].play, example["record"].HIDDEN
    plain = play(plan, scene, hidden["none"])
    assert np.array_equal(plain["object_pose"], play(plan, scene, {})["object_pose"]), "the engine repeats itself"
    for name, channel in (("mass", "object_pose"), ("friction", "object_pose"), ("damping", "joint_position")):
        changed = play(plan, scene, hidden[name])
        assert np.abs(plain[channel] - changed[channel]).max() > 3e-3, name


def run(*arguments: str, before: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    """The script as its user starts it, with folders that are searched for packages first."""
    paths = os.pathsep.join([*before, str(FOLDER.parents[1])])
    return subprocess.run(
        [sys.executable, str(FOLDER / "record.py"), *arguments],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )


def test_numbers_that_mean_nothing_are_refused(tmp_path):
    done = run("--out", str(tmp_path / "out"), "--duration-s", "0")
    assert done.returncode == 2
    assert done.stderr.endswith("error: give at least 1 episode of 0.5 to 60 s, and a seed from 0 on\n")
    assert not (tmp_path / "out").exists()


def test_without_the_engine_the_example_says_what_to_install(tmp_path):
    """A package that is not there is a line, not a traceback."""
    (tmp_path / "pybullet.py").write_text("raise ImportError")
    done = run("--out", str(tmp_path / "out"), before=(str(tmp_path),))
    assert done.returncode == 3
    assert done.stderr.startswith("pybullet is not installed\n  do: pip install")
    assert not (tmp_path / "out").exists()
