"""Sound recordings that rules took for wrong: fingers that are stopped, motions that are small, parts that give."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from candata.checks import check, defects
from candata.datasets import open_dataset
from candata.gap.blind.rigs.cases import write_rig_case
from candata.rotation import exp
from candata.scenes import load_scene
from candata.schema.bench import Label
from candata.schema.episode import Episode, EpisodeMeta

ROOT = Path(__file__).parents[2]
RATE_HZ, ROWS = 100.0, 300
TIME_S = np.arange(ROWS) / RATE_HZ


def stored(name, task=None, **arrays):
    """A stored episode of some channels; joints and commands go by the same names."""
    joints = tuple(f"j{k}" for k in range(arrays["joint_position"].shape[1])) if "joint_position" in arrays else ()
    meta = EpisodeMeta(
        id=name,
        source="real",
        rate_hz=RATE_HZ,
        task=task,
        joint_names=joints,
        actuator_names=joints * ("action" in arrays),
    )
    return defects.as_stored(Episode(meta, {"time_ns": np.round(TIME_S * 1e9).astype(np.int64)} | arrays))


def waves(seed, count):
    """Smooth commands `(T, count)` of about half a radian."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(0.6, 1.2, (3, count)), rng.uniform(0, 6, (3, count))
    return 0.2 * np.sin(2 * np.pi * rate * TIME_S[:, None, None] + phase).sum(1)


def behind(values, rows):
    """Values `(T, N)` some rows later, a number of each column; between rows by a line."""
    at = np.clip(np.arange(ROWS)[:, None] - np.broadcast_to(rows, values.shape), 0, ROWS - 1)
    return np.stack([np.interp(at[:, k], np.arange(ROWS), values[:, k]) for k in range(values.shape[1])], axis=1)


def read(values, seed, noise=0.0005):
    return values + np.random.default_rng(seed).normal(0, noise, values.shape)


def told(judged, raws, rule):
    return [(f.level, f.problem) for f in judged(raws, rules=[rule])]


def test_joints_that_press_on_what_they_hold_are_no_drift_of_clocks(judged):
    """Four joints: two stay free; two close on a can half way, move less from there on, and come later."""
    raws = []
    for k in range(6):
        action = waves(k, 4)
        held = np.where(TIME_S > 1.3, 1.0, 0.0)[:, None] * [0, 0, 1, 1]
        joint = behind(action, 3 + 8 * held) * (1 - 0.45 * held)
        raws.append(stored(f"e{k}", action=action, joint_position=read(joint, k)))
    assert told(judged, raws, "stream_drift") == []


def test_all_joints_falling_behind_are_a_drift_of_clocks(judged):
    raws = []
    for k in range(6):
        action = waves(k, 4)
        joint = behind(action, 3 + 12 * TIME_S[:, None] / TIME_S[-1])
        raws.append(stored(f"e{k}", action=action, joint_position=read(joint, k)))
    assert told(judged, raws, "stream_drift") == [("warning", "streams drift apart")]


@pytest.mark.parametrize(("slow", "expected"), [((0, 0, 5), []), ((0, 5, 5), []), ((5, 5, 5), ["e7"])])
def test_commands_are_shifted_where_all_joints_are(judged, slow, expected):
    """In the odd episode some joints come late, as something is in their way, or all do."""
    raws = []
    for k in range(10):
        action = waves(k, 3)
        joint = behind(action, 3 + np.array(slow if k == 7 else (0, 0, 0)))
        raws.append(stored(f"e{k}", "sweep", action=action, joint_position=read(joint, k)))
    assert [f.episode for f in judged(raws, rules=["command_lag"])] == expected


def test_a_fingertip_that_misses_the_object_once_is_not_dead(judged):
    """Without noise, what touches nothing reads zero; the others chatter on what they push."""
    raws = []
    for k in range(12):
        chatter = np.abs(np.random.default_rng(k).normal(0, 0.1, (ROWS, 3))) * (TIME_S > 1)[:, None]
        force = chatter[..., None] * [0.0, 0.1, 1.0]
        force[:, 2] *= k != 5
        raws.append(stored(f"e{k}", "push", fingertip_force=force, joint_position=np.zeros((ROWS, 1))))
    assert told(judged, raws, "dead_finger") == []


def presses(task_s, k):
    """A finger that is commanded to close at 0.5 s and meets the object some time later [s]."""
    action = 0.6 * np.clip((TIME_S - 0.5 - 0.02 * k) / 0.1, 0, 1)[:, None]
    joint = behind(action, 4)
    force = np.zeros((ROWS, 1, 3))
    force[:, 0, 2] = 3 * np.clip((TIME_S - 0.5 - 0.02 * k - task_s) / 0.1, 0, 1)
    return {"action": action, "joint_position": read(joint, k), "fingertip_force": force}


def test_one_motion_does_not_tell_a_late_force_from_a_late_touch(judged):
    raws = [stored(f"e{k}", "squeeze", **presses(0.2, k)) for k in range(8)]
    assert told(judged, raws, "force_delay") == []


def test_motions_that_agree_on_a_delay_tell_it(judged):
    raws = [stored(f"e{k}", ("squeeze", "push")[k % 2], **presses(0.2, k)) for k in range(8)]
    assert told(judged, raws, "force_delay") == [("warning", "forces come after the fingers are stopped")]


def pose(turn, height=0.05):
    return np.c_[np.tile([0.1, 0.0, height], (ROWS, 1)), exp(turn)]


def test_what_sways_or_rolled_about_one_axis_holds_no_swapped_quaternion(judged):
    """Read as x y z w, a turn about x stands on its head, whatever its angle."""
    rng = np.random.default_rng(0)
    sways = [np.outer(0.1 * np.sin(9 * TIME_S + k), [0.05, 1, 0.05]) for k in range(8)]
    rolled = [np.outer(np.clip(TIME_S, 0, 1.5) * rng.uniform(0.3, 1.5), [1.0, 0, 0]) for k in range(8)]
    for turns in (sways, rolled):
        raws = [stored(f"e{k}", object_pose=pose(read(turn, k, 0.003))) for k, turn in enumerate(turns)]
        assert told(judged, raws, "quaternion_order") == []


@pytest.mark.parametrize("noise", [0.0, 0.0005])
def test_a_small_motion_is_no_unit(judged, noise):
    """In one of twelve episodes closed fingers move a fortieth of what they do in the others."""
    raws = [
        stored(f"e{k}", joint_position=read(0.8 + waves(k, 3) / (40 if k == 4 else 1), k, noise)) for k in range(12)
    ]
    assert told(judged, raws, "scale") == []


@pytest.mark.parametrize("noise", [0.0, 0.0005])
def test_a_unit_of_one_episode_is_told(judged, noise):
    raws = [
        stored(f"e{k}", joint_position=(180 / np.pi if k == 4 else 1) * read(0.8 + waves(k, 3), k, noise))
        for k in range(12)
    ]
    assert [f.episode for f in judged(raws, rules=["scale"])] == ["e4"]


def test_a_grip_that_creeps_is_no_drift_of_the_tare(judged):
    """What is held from the first row to the last, and worked on, has a trend now and then."""
    raws = []
    for k in range(6):
        rng = np.random.default_rng(k)
        force = np.zeros((ROWS, 1, 3))
        force[:, 0, 0] = 2.5 - 0.35 * TIME_S + 0.15 * np.sin(2 * np.pi * 2.3 * TIME_S + k)
        raws.append(stored(f"e{k}", joint_position=np.zeros((ROWS, 1)), fingertip_force=read(force, rng, 0.04)))
    assert told(judged, raws, "force_drift") == []


@pytest.mark.parametrize(("pressing", "free"), [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_a_force_drifts_if_it_does_so_out_of_contact_too(judged, pressing, free):
    """It presses by 1 N along x; along z it reads a line that rises by 0.6 N, pressing, out of contact or both."""
    touching = (TIME_S > 0.4) & (TIME_S < 2.85)
    force = np.zeros((ROWS, 1, 3))
    force[touching, 0, 0] = 1.0
    force[:, 0, 2] = 0.6 * TIME_S / TIME_S[-1] * np.where(touching, pressing, free)
    raws = [
        defects.with_derived_flags(
            stored(f"e{k}", joint_position=np.zeros((ROWS, 1)), fingertip_force=read(force, k, 0.02))
        )
        for k in range(6)
    ]
    expected = [("warning", "a force drifts")] * 6 if pressing and free else []
    assert told(judged, raws, "force_drift") == expected


def test_poses_of_nothing_are_told_with_their_value_and_rows(judged):
    poses = pose(np.zeros((ROWS, 3)))
    poses[[20, 100, 101]] = [0, 0, 0, 1, 0, 0, 0]
    (found,) = judged([stored("e", object_pose=poses)], rules=["lost_poses"])
    assert found.message == "poses of nothing: they jump to one value and back: 3 of 300 rows at 0 0 0"
    assert found.index == 20


def test_what_rests_at_the_origin_is_something(judged):
    assert (
        told(judged, [stored("e", object_pose=pose(np.zeros((ROWS, 3)), 0.0) * [0, 1, 1, 1, 1, 1, 1])], "lost_poses")
        == []
    )


def test_parts_that_give_are_not_where_the_model_has_them(tmp_path):
    """A finger on a spring that nobody recorded: the fingertip is not known to be far, nor deep in what it touches."""
    write_rig_case(tmp_path / "set", Label(case="case-0001", kind="null", trait="spring", seed=1000111), "", 12)
    found = check(
        open_dataset(tmp_path / "set"),
        scene=load_scene(tmp_path / "set" / "scene.yaml"),
        rules=["penetration", "proximity"],
    )
    assert [(f.level, f.rule) for f in found] == [("unknown", "proximity")]
    assert "move by joints that were not recorded" in found[0].message


def test_no_rule_accuses_sound_recordings(tmp_path):
    """`benchmarks/clean_checks.py` at a hundredth of its size, and what a second run of it does."""
    command = [sys.executable, "benchmarks/clean_checks.py", "--episodes", "24", "--out", str(tmp_path)]
    first, again = (subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False) for _ in range(2))
    assert first.returncode == 0, first.stdout
    assert "target: no error, warnings in at most 0.1 %: met" in first.stdout
    assert (again.stdout, again.stderr) == (first.stdout, "")
