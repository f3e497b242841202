"""Joints that follow their commands with a lag, fitted on recordings that do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import DataError
from candata.loaders import windows
from candata.schema.manifest import Lineage
from candata.training.forecasters import ForecastArrays
from candata.training.rollout import close_loop, course
from candata.training.servo_lag import TIME_CONSTANTS_S, ServoLags, fit_servo_lags, followed_joints
from tests.training.conftest import RATE_HZ, gliding

TRUE = ServoLags(
    np.array([0, 1]), np.array([1, 0]), TIME_CONSTANTS_S[[20, 24]], np.array([0.8, 1.1]), np.array([0.1, 0.0])
)


def driven(name: str, seed: int):
    """An episode whose joints a and b follow the actuators of their names, which stand in the other order."""
    episode = gliding(name, seed)
    rng, arrays = np.random.default_rng(seed), dict(episode.arrays)
    arrays["action"] = np.repeat(rng.normal(size=(13, 2)), 5, axis=0)[: len(episode)]
    begin = rng.normal(size=2)
    arrays["joint_position"] = np.concatenate([begin[None], TRUE.follow(begin, arrays["action"][:-1], RATE_HZ)])
    meta = episode.meta.model_copy(update={"actuator_names": ("b", "a")})
    return replace(episode, meta=meta, arrays=arrays)


@pytest.fixture
def driven_windows(tmp_path):
    folder = create_dataset(tmp_path / "driven", name="driven")
    append(folder, [driven(f"e{k}", k) for k in range(4)], Lineage(operation="test"))
    return windows(open_dataset(folder), history=4, horizon=6, pad="both", step=2)


def test_what_moved_the_joints_is_found(driven_windows):
    lags = fit_servo_lags(driven_windows)
    np.testing.assert_array_equal(lags.actuators, [1, 0])
    np.testing.assert_array_equal(lags.time_constant_s, TRUE.time_constant_s)
    # Rows are kept in float32.
    np.testing.assert_allclose(lags.gain, TRUE.gain, atol=1e-5)
    np.testing.assert_allclose(lags.offset, TRUE.offset, atol=1e-5)


def test_a_course_follows_its_commands_from_where_it_begins(driven_windows):
    followed = course(driven_windows)
    joints = followed_joints(followed, TRUE)
    begin = driven_windows.cache.begin[2]
    recorded = driven_windows.cache.rows["joint_position"][begin + 8 : begin + 61 : 2]
    np.testing.assert_allclose(joints[2, : followed.steps[2]], recorded, atol=1e-5)


def test_the_loop_is_fed_the_joints_of_the_course(driven_windows):
    seen = []

    class Watches:
        summary = "watches"

        def forecast(self, batch, seed):
            seen.append({name: np.array(values) for name, values in batch.items()})
            return ForecastArrays(np.zeros((1, *batch["future_pad"].shape, 6)), None)

    recorded = course(driven_windows)
    marked = np.full((*recorded.valid.shape, 2), 7.0)
    close_loop(replace(recorded, joints=marked), Watches(), execute=3, seed=0)
    assert not (seen[0]["history/joint_position"] == 7).any()
    # Three steps on, the first of four rows is the one at which the loop began, as recorded.
    fed = seen[1]["history/joint_position"]
    assert (fed[:, 1:] == 7).all()
    np.testing.assert_array_equal(fed[:, 0], seen[0]["history/joint_position"][:, -1])


def test_joints_without_an_actuator_of_their_name_are_an_error(dataset):
    unnamed = windows(dataset(actuator_names=("left", "right")), history=4, horizon=6)
    with pytest.raises(DataError, match=r"no servo to model\n\s+expected: .*\n\s+found: joints a, b; actuators left"):
        fit_servo_lags(unnamed)
