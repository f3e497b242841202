"""A scene of independent servos for a robot without a model."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import DataError, UsageError
from candata.scenes import load_scene
from candata.scenes.servo import servo_joints, write_servo_scene

RANGES = np.array([[-1.0, 1.0], [0.2, 0.3]])


def test_each_joint_has_its_own_servo_and_nothing_couples_them(tmp_path):
    scene = load_scene(write_servo_scene(tmp_path / "new", ("a", "b"), RANGES, 30.0, noise=0.001))
    assert (scene.file.joints, scene.file.actuator_names, scene.file.object) == (("a", "b"), ("a", "b"), None)
    assert scene.file.noise.joint_position == 0.001
    assert scene.substeps == 8
    model = scene.model
    assert model.nbody == 3
    assert not model.opt.gravity.any()
    # Critical damping, natural frequency 5 Hz: kp / I = w^2, kv / I = 2 w.
    w = 2 * np.pi * 5
    inertia = model.dof_M0
    np.testing.assert_allclose(model.actuator_gainprm[:, 0] / inertia, w**2, rtol=1e-6)
    np.testing.assert_allclose(-model.actuator_biasprm[:, 2] / inertia, 2 * w, rtol=1e-6)


def test_a_scene_that_stands_is_kept(tmp_path):
    target = write_servo_scene(tmp_path, ("a", "b"), RANGES, 30.0)
    before = target.read_text()
    with pytest.raises(UsageError, match="a scene stands there"):
        write_servo_scene(tmp_path, ("a", "b"), RANGES, 60.0)
    assert target.read_text() == before


@pytest.mark.parametrize(
    ("names", "ranges"),
    [((), np.zeros((0, 2))), (("a", "a"), RANGES), (("a", ""), RANGES), (("a", "b"), RANGES * np.nan)],
)
def test_joints_that_make_no_scene_are_refused(tmp_path, names, ranges):
    with pytest.raises(DataError):
        write_servo_scene(tmp_path / "new", names, ranges, 30.0)
    assert not (tmp_path / "new").exists()


def test_names_and_ranges_come_from_the_episodes(episode):
    with pytest.raises(DataError, match="joints and commands do not match") as caught:
        servo_joints([episode("one")])
    assert caught.value.found == "no action"
    with pytest.raises(DataError, match="the joints have no names"):
        servo_joints([])
