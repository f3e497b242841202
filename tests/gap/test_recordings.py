"""Recordings: by name, on the scene's clock, padded; what does not fit is refused with one clear text."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.errors import DataError
from candata.gap.data import recordings as module
from candata.gap.data.recordings import read, recordings
from candata.schema.episode import Episode, EpisodeMeta


def episode(rows: int = 6, drop: tuple[str, ...] = (), arrays: dict | None = None, **meta: object) -> Episode:
    """An episode of the arm in which every number tells its row and column."""
    table = np.arange(rows)[:, None] + np.array([0.0, 0.5])
    base = {"time_ns": np.arange(rows) * 10_000_000, "joint_position": table, "action": 100 + table}
    fields = {"id": "e0", "source": "real", "rate_hz": 100.0}
    fields |= {"joint_names": ("shoulder", "elbow"), "actuator_names": ("shoulder", "elbow")}
    kept = {k: v for k, v in (base | (arrays or {})).items() if k not in drop}
    return Episode(EpisodeMeta.model_validate(fields | meta), kept)


def refusal(scene, *episodes: Episode) -> str:
    with pytest.raises(DataError) as caught:
        recordings(scene, episodes)
    return str(caught.value)


def pose(rows: int) -> np.ndarray:
    return np.tile([0.0, 0, 0, 1, 0, 0, 0], (rows, 1))


def test_columns_follow_names_not_places(arm):
    straight = episode()
    turned = {c: straight[c][:, ::-1] for c in ("joint_position", "action")}
    names = ("elbow", "shoulder")
    swapped = episode(arrays=turned, joint_names=names, actuator_names=names)
    a, b = recordings(arm, [straight]), recordings(arm, [swapped])
    assert np.array_equal(a.readings["joint_position"], b.readings["joint_position"])
    assert np.array_equal(a.commands, b.commands)
    assert np.array_equal(a.commands[0], straight["action"])


def test_fingertips_follow_names_not_places(hand, rng):
    tips = hand.file.fingertips
    order = rng.permutation(len(tips))
    force = rng.standard_normal((4, len(tips), 3)).astype(np.float32)
    joints = np.zeros((4, len(hand.file.joints)))
    meta = {"rate_hz": hand.file.rate_hz, "joint_names": hand.file.joints, "actuator_names": hand.file.actuator_names}
    arrays = {"joint_position": joints, "action": joints, "fingertip_force": force[:, order]}
    made = episode(4, arrays=arrays, fingertip_names=tuple(tips[i] for i in order), **meta)
    assert np.array_equal(recordings(hand, [made]).readings["fingertip_force"][0], force)


def test_a_recording_may_hold_more_joints_than_the_scene(arm):
    wide = {"joint_position": np.arange(18.0).reshape(6, 3)}
    found = recordings(arm, [episode(arrays=wide, joint_names=("elbow", "wrist", "shoulder"))])
    assert np.array_equal(found.readings["joint_position"][0], wide["joint_position"][:, [2, 0]])


def test_columns_without_names_are_taken_in_order(arm):
    found = recordings(arm, [episode(joint_names=(), actuator_names=())])
    assert np.array_equal(found.readings["joint_position"][0], episode()["joint_position"])


def test_a_wrong_count_of_joints_is_refused(arm):
    wide = {"joint_position": np.zeros((6, 3))}
    assert refusal(arm, episode(arrays=wide, joint_names=("a", "b", "c"))) == (
        "joint_position does not fit the scene\n"
        "  expected: 2 columns: shoulder, elbow\n"
        "  found: 3: a, b, c\n"
        "  where: episode e0, channel joint_position\n"
        "  do: list the same joints in scene.yaml and in the map, in the order of the columns"
    )
    assert "\n  found: 3: without names\n" in refusal(arm, episode(arrays=wide, joint_names=()))


def test_a_wrong_count_of_commands_is_refused(arm):
    text = refusal(arm, episode(arrays={"action": np.zeros((6, 1))}, actuator_names=("shoulder",)))
    assert text.startswith(
        "action does not fit the scene\n  expected: 2 columns: shoulder, elbow\n  found: 1: shoulder\n"
    )


def test_a_wrong_rate_is_refused(arm):
    assert refusal(arm, episode(rate_hz=80.0)) == (
        "the episode's rate is not the scene's\n"
        "  expected: 100 Hz\n"
        "  found: 80 Hz, 0.8 times that\n"
        "  where: episode e0\n"
        "  do: give map.yaml (or the episode) and scene.yaml the true rate of the recording"
    )


@pytest.mark.parametrize(("rate_hz", "fits"), [(98.1, True), (101.9, True), (97.9, False), (102.1, False)])
def test_clocks_may_differ_by_two_per_cent(arm, rate_hz, fits):
    if fits:
        assert len(recordings(arm, [episode(rate_hz=rate_hz)])) == 1
    else:
        assert refusal(arm, episode(rate_hz=rate_hz)).startswith("the episode's rate is not the scene's")


def test_missing_commands_are_refused(arm):
    assert refusal(arm, episode(drop=("action",), actuator_names=())) == (
        "the scene has actuators but the episode has no commands\n"
        "  expected: channel action\n"
        "  found: time_ns, joint_position\n"
        "  where: episode e0\n"
        "  do: map the commands to `action`, or list no actuators in scene.yaml"
    )


def test_nothing_to_compare_is_refused(arm):
    # The arm's scene has no object, so a pose cannot be predicted.
    assert refusal(arm, episode(drop=("joint_position",), arrays={"object_pose": pose(6)}, joint_names=())) == (
        "nothing to compare\n"
        "  expected: one of joint_position, object_pose, fingertip_force in every episode\n"
        "  found: time_ns, object_pose, action"
    )
    assert refusal(arm).endswith("found: no episodes")


def test_a_channel_is_compared_only_where_every_episode_has_it(hand):
    meta = {"rate_hz": hand.file.rate_hz, "joint_names": hand.file.joints, "actuator_names": hand.file.actuator_names}
    joints = np.zeros((4, len(hand.file.joints)))
    arrays = {"joint_position": joints, "action": joints, "object_pose": pose(4)}
    whole, part = episode(4, arrays=arrays, **meta), episode(4, ("object_pose",), arrays, **meta | {"id": "e1"})
    assert set(recordings(hand, [whole]).readings) == {"joint_position", "object_pose"}
    assert set(recordings(hand, [whole, part]).readings) == {"joint_position"}


def test_a_command_recorded_as_the_one_before_belongs_to_the_row_before(arm):
    found = recordings(arm, [episode(action="previous")]).commands[0]
    assert np.array_equal(found[:-1], episode()["action"][1:])
    assert np.array_equal(found[-1], episode()["action"][-1])


def test_a_gap_in_the_commands_holds_the_command_before_it(arm):
    action = episode()["action"].copy()
    action[2:4] = np.nan
    seen = np.isfinite(action[:, 0])
    found = recordings(arm, [episode(arrays={"action": action, "action_valid": seen})]).commands[0]
    assert np.array_equal(found, episode()["action"][[0, 1, 1, 1, 4, 5]])


def test_a_gap_at_the_first_command_is_refused(arm):
    seen = np.arange(6) > 0
    assert refusal(arm, episode(arrays={"action_valid": seen})) == (
        "the first command is not valid\n  where: episode e0, channel action, index 0"
    )


def test_rows_that_are_not_valid_are_not_compared(arm):
    seen = np.array([True, True, False, True, True, False])
    found = recordings(arm, [episode(arrays={"joint_position_valid": seen})]).readings["joint_position"][0]
    assert np.array_equal(np.isfinite(found), np.repeat(seen[:, None], 2, axis=1))


def test_shorter_episodes_end_in_nothing_recorded_and_a_held_command(arm):
    found = recordings(arm, [episode(4, id="short"), episode(6)])
    assert found.lengths.tolist() == [4, 6]
    assert np.isnan(found.readings["joint_position"][0, 4:]).all()
    assert np.isfinite(found.readings["joint_position"][1]).all()
    assert np.array_equal(found.commands[0, 4:], np.repeat(found.commands[0, 3:4], 2, axis=0))


def test_taking_episodes_keeps_their_order(arm):
    found = recordings(arm, [episode(n, id=f"e{n}", task=f"t{n}") for n in (4, 5, 6)]).take([2, 0])
    assert (found.ids, found.tasks, found.lengths.tolist()) == (("e6", "e4"), ("t6", "t4"), [6, 4])
    assert np.isnan(found.readings["joint_position"][1, 4:]).all()


@pytest.mark.parametrize("force", ["mean", "instant"])
def test_the_declared_kind_of_force_is_kept(arm, force):
    assert recordings(arm, [episode(force=force)]).instant_force is (force == "instant")


def test_two_kinds_of_force_are_not_mixed(arm):
    assert "force" in refusal(arm, episode(force="mean"), episode(id="e1", force="instant"))


def twelve(*broken: Episode) -> list[Episode]:
    """Twelve episodes of which the first ones are the broken."""
    return [*broken, *(episode(20, id=f"s{i}") for i in range(12 - len(broken)))]


def gapped(rows: int = 20, **meta: object) -> Episode:
    """An episode that lost ten rows in its middle: its stamps jump."""
    stamps = np.arange(rows) * 10_000_000
    stamps[rows // 2 :] += 100_000_000
    return episode(rows, arrays={"time_ns": stamps}, **meta)


def test_episodes_that_cannot_be_replayed_are_left_out_by_name(arm):
    unseen = np.arange(20) > 0
    made = twelve(gapped(id="jump"), episode(20, id="late", arrays={"action_valid": unseen}), episode(1, id="short"))
    found = recordings(arm, made)
    assert found.ids == tuple(f"s{i}" for i in range(9))
    assert found.notes == (
        "3 of 12 episodes left out (jump: stamps do not keep the rate: rows are missing, or the clock jumps; "
        "late: the first command is not valid; short: episodes are too short to replay)",
    )


def test_a_clock_that_jumps_in_every_episode_is_refused(arm):
    assert refusal(arm, gapped()) == (
        "stamps do not keep the rate: rows are missing, or the clock jumps\n"
        "  expected: row 10 at 0.100 s (100 Hz)\n"
        "  found: 0.200 s\n"
        "  where: episode e0, channel time_ns, index 10\n"
        "  do: import it on a regular grid, or give the true rate"
    )


def test_a_clock_that_drifts_or_jitters_is_no_fault(arm, rng):
    stamps = np.arange(200) * 10_200_000 + rng.integers(0, 5_000_000, 200)
    assert len(recordings(arm, [episode(200, arrays={"time_ns": stamps})])) == 1


def test_half_the_episodes_broken_leaves_the_other_half(arm):
    made = twelve(*(gapped(id=f"b{i}") for i in range(6)))
    assert recordings(arm, made).ids == tuple(f"s{i}" for i in range(6))


@pytest.mark.parametrize(("have", "kept", "compared"), [(10, 10, True), (8, 8, True), (7, 12, False), (5, 12, False)])
def test_a_channel_that_few_episodes_lack_costs_these_episodes(hand, have, kept, compared):
    joints = np.zeros((4, len(hand.file.joints)))
    names = {"joint_names": hand.file.joints, "actuator_names": hand.file.actuator_names, "rate_hz": hand.file.rate_hz}
    arrays = {"joint_position": joints, "action": joints, "object_pose": pose(4)}
    drops = [() if i < have else ("object_pose",) for i in range(12)]
    found = recordings(hand, [episode(4, d, arrays, id=f"e{i}", **names) for i, d in enumerate(drops)])
    assert (len(found), "object_pose" in found.readings, len(found.notes)) == (kept, compared, 1)


def test_a_channel_without_valid_rows_was_not_recorded(hand):
    joints = np.zeros((4, len(hand.file.joints)))
    names = {"joint_names": hand.file.joints, "actuator_names": hand.file.actuator_names, "rate_hz": hand.file.rate_hz}
    arrays = {
        "joint_position": joints,
        "action": joints,
        "object_pose": pose(4),
        "object_pose_valid": np.zeros(4, bool),
    }
    assert set(recordings(hand, [episode(4, arrays=arrays, **names)]).readings) == {"joint_position"}


def test_of_a_large_dataset_no_more_than_so_many_episodes_are_read_and_that_is_said(arm, as_dataset, monkeypatch):
    dataset = as_dataset([episode(id=f"e{i}") for i in range(9)])
    assert (len(read(arm, dataset)), read(arm, dataset).notes) == (9, ())
    monkeypatch.setattr(module, "READ", 4)
    found = read(arm, dataset)
    assert len(found) == 4
    assert set(found.ids) < set(dataset.ids)
    assert found.notes == ("4 of 9 episodes looked at, drawn at random",)
    assert read(arm, dataset).ids == found.ids


def test_episodes_end_where_a_servo_is_switched_off(arm, arm_episodes):
    """Its replay goes on to follow the commands; the joint falls."""
    first, second = arm_episodes(count=2)
    off = np.ones((160, 2), bool)
    off[100:, 1] = False
    released = replace(first, arrays=dict(first.arrays) | {"torque_on": off})
    recs = recordings(arm, [released, second])
    assert recs.lengths.tolist() == [100, 160]
    assert any(note.startswith("1 of 2 episodes end where a servo is switched off") for note in recs.notes)
