from __future__ import annotations

import numpy as np
import pytest

from candata.datasets.measures import Statistic, commanded_joints, lag_s, measure
from candata.schema.episode import Episode, EpisodeMeta

RATE = 100.0


def made(rows=300, **arrays):
    meta = {k: arrays.pop(k) for k in ("joint_names", "actuator_names") if k in arrays}
    return Episode(
        EpisodeMeta.model_validate({"id": "e", "source": "sim", "rate_hz": RATE} | meta),
        {"time_ns": np.arange(rows) * 10_000_000} | arrays,
    )


def of(found, name, element=""):
    return next(values for key, values in found.items() if (key.name, key.element) == (name, element))


def test_a_joint_that_turns_evenly_has_its_speed_and_no_acceleration():
    time = np.arange(300) / RATE
    found = measure(made(joint_position=(2.0 * time)[:, None]), 0.01)
    # float32 positions near 6 are 5e-7 apart: 5e-5 rad/s over 10 ms
    assert of(found, "joint speed", "joint 0") == pytest.approx(2.0, abs=1e-3)
    assert np.median(of(found, "joint acceleration", "joint 0")) < 0.02


def test_free_fall_accelerates_by_g():
    time = np.arange(100) / RATE
    pose = np.zeros((100, 7))
    pose[:, 2], pose[:, 3] = -0.5 * 9.81 * time**2, 1.0
    found = measure(made(100, object_pose=pose), 0.05)
    assert of(found, "object acceleration") == pytest.approx(9.81, rel=1e-3)  # float32 positions
    assert of(found, "object turning rate") == pytest.approx(0.0, abs=1e-6)


def test_no_step_is_taken_over_a_gap():
    position = np.where(np.arange(300) < 150, 0.0, 100.0)[:, None]
    valid = np.abs(np.arange(300) - 150) > 3
    found = measure(made(joint_position=position, joint_position_valid=valid), 0.01)
    assert of(found, "joint speed", "joint 0").max() == 0.0
    assert of(found, "joint acceleration", "joint 0").max() == 0.0


def test_contacts_have_their_durations_onsets_impulse_and_peak():
    touch = np.zeros((300, 1), bool)
    touch[50:100], touch[200:210] = True, True
    force = np.zeros((300, 1, 3))
    force[50:100, 0, 2], force[200:210, 0, 0] = 2.0, 5.0
    found = measure(made(joint_position=np.zeros((300, 1)), fingertip_force=force, fingertip_contact=touch), 0.01)
    tip = "fingertip 0"
    assert of(found, "contact duration", tip) == pytest.approx([0.5, 0.1])
    assert of(found, "onsets per second", tip) == pytest.approx(2 / 2.99)
    assert of(found, "impulse per contact", tip) == pytest.approx([1.0, 0.5])
    assert of(found, "peak force per contact", tip) == pytest.approx([2.0, 5.0])
    assert of(found, "share of the episode in contact", tip) == pytest.approx(0.2)
    assert sum(of(found, "share of the episode in phase", p)[0] for p in ("free", "onset", "sustained", "release")) == 1


def test_contact_follows_from_forces_where_no_channel_says():
    force = np.zeros((100, 2, 3))
    force[20:60, 1, 0] = 0.31
    found = measure(made(100, joint_position=np.zeros((100, 1)), fingertip_force=force), 0.01)
    assert of(found, "contact duration", "fingertip 1") == pytest.approx([0.4])
    assert Statistic("force", "force in contact", "N", "fingertip 0") not in found


@pytest.mark.parametrize("rows", [0, 3, 7])
def test_a_planted_lag_is_found(rng, rows):
    command = np.cumsum(rng.normal(size=400))
    position = np.roll(command, rows) if rows else command
    position[: rows + 1] = command[0]
    assert lag_s(command, position, RATE) == pytest.approx(rows / RATE, abs=0.2 / RATE)  # a parabola's error


def test_a_lag_between_rows_is_found():
    time = np.arange(800) / RATE
    command, position = np.sin(7 * time), np.sin(7 * (time - 0.034))
    assert lag_s(command, position, RATE) == pytest.approx(0.034, abs=0.001)


def test_no_lag_where_nothing_moves_or_nothing_follows(rng):
    assert np.isnan(lag_s(np.zeros(100), np.zeros(100), RATE))
    assert np.isnan(lag_s(rng.normal(size=400), rng.normal(size=400), RATE))


def test_commands_meet_the_position_that_they_cause():
    position, action = np.arange(5.0)[:, None], np.arange(5.0)[:, None] + 1
    names = {"joint_names": ("a",), "actuator_names": ("a",)}
    (after,) = commanded_joints(made(5, joint_position=position, action=action, **names))
    assert np.array_equal(after[1], after[2])  # held over [k, k + 1), so met at k + 1
    (before,) = commanded_joints(made_previous(position, action - 1, names))
    assert np.array_equal(before[1], before[2])


def made_previous(position, action, names):
    base = made(5, joint_position=position, **names)
    meta = base.meta.model_copy(update={"action": "previous"})
    return Episode(meta, dict(base.arrays) | {"action": action})


def test_commands_of_other_names_are_not_guessed():
    arrays = {"joint_position": np.zeros((5, 2)), "action": np.zeros((5, 2))}
    assert [name for name, *_ in commanded_joints(made_pair(arrays, ("a", "b"), ("c", "b")))] == ["b"]
    assert [name for name, *_ in commanded_joints(made_pair(arrays, (), ()))] == ["joint 0", "joint 1"]
    assert list(commanded_joints(made_pair(arrays | {"action": np.zeros((5, 3))}, (), ()))) == []


def made_pair(arrays, joints, actuators):
    meta = EpisodeMeta(id="e", source="sim", rate_hz=RATE, joint_names=joints, actuator_names=actuators)
    return Episode(meta, {"time_ns": np.arange(5) * 10_000_000} | arrays)


def test_one_row_has_no_motion_and_no_lag():
    found = measure(made(1, joint_position=np.zeros((1, 1)), action=np.zeros((1, 1))), 0.01)
    assert {key.name for key in found} == set()
