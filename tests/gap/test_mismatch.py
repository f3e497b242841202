"""Mismatch: every fault of the recording is found, and no effect of the library is taken for one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from candata.effects import effect, effect_names
from candata.errors import DataError
from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate
from candata.gap.mismatch import timing
from candata.gap.mismatch.check import checked, mismatch
from candata.gap.mismatch.commands import paired
from candata.gap.replay.replayer import Replayer
from candata.scenes import Scene, load_scene
from candata.schema.episode import Episode, EpisodeMeta
from candata.simulate import at_rest, rollout
from candata.simulate.episodes import add_noise
from tests.gap.recording_faults import FAULTS, changed, channel, columns, drawn, found, frozen, to_world

GRIPPER = """<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/>
<default><geom friction="0.9 .005 .0001" condim="4" solref="0.01 1"/></default><worldbody>
  <geom name="table" type="plane" size=".5 .5 .05"/>
  <body name="wrist" pos="0 0 .04">
    <joint name="lift" type="slide" axis="0 0 1" range="-.02 .15" limited="true" damping="2" armature=".1"/>
    <geom type="sphere" size=".015" mass=".5" contype="0" conaffinity="0"/>
    <body name="left" pos="0 .05 0" euler="0 0 .5"><joint name="left" axis="0 0 -1" range="-.2 1.4" armature=".001"/>
      <geom type="capsule" fromto="0 0 0 .07 0 0" size=".006" mass=".03" contype="0" conaffinity="0"/>
      <geom name="left_tip" type="sphere" pos=".08 0 0" size=".012" mass=".01"/></body>
    <body name="right" pos="0 -.05 0" euler="0 0 -.6"><joint name="right" axis="0 0 1" range="-.2 1.6" armature=".001"/>
      <geom type="capsule" fromto="0 0 0 .07 0 0" size=".006" mass=".03" contype="0" conaffinity="0"/>
      <geom name="right_tip" type="sphere" pos=".08 0 0" size=".012" mass=".01"/></body></body>
  <body name="box" pos=".09 0 .03"><freejoint/><geom type="box" size=".025 .03 .03" mass=".15"/></body></worldbody>
  <actuator>
    <position name="lift" joint="lift" kp="2000" kv="60" ctrlrange="-.02 .15" forcerange="-60 60"/>
    <position name="left" joint="left" kp="2.5" kv=".06" ctrlrange="-.2 1.4" forcerange="-1 1"/>
    <position name="right" joint="right" kp="4" kv=".12" ctrlrange="-.2 1.6" forcerange="-1 1"/>
  </actuator></mujoco>
"""
ROLES = """model: gripper.xml
rate_hz: 80
object: box
joints: [lift, left, right]
actuators: [lift, left, right]
fingertips: [left_tip, right_tip]
support: table
noise: {object_pose: [0.001, 0.005], joint_position: 0.002, fingertip_force: 0.02, force_step: 0.05}
"""
MOTIONS = ("grasp_lift_shake", "free_sweep", "squeeze")


@pytest.fixture(scope="module")
def gripper(tmp_path_factory) -> Scene:
    """A user's own: two fingers on a lift, a box on a table."""
    folder = tmp_path_factory.mktemp("gripper")
    (folder / "gripper.xml").write_text(GRIPPER)
    (folder / "scene.yaml").write_text(ROLES)
    return load_scene(folder / "scene.yaml")


@pytest.fixture(scope="module")
def gripped(gripper, played) -> list[Episode]:
    return played(gripper, policies=MOTIONS, count=6)


GRIPPER_FAULTS = {k: v for k, v in FAULTS.items() if k != "force in world"} | {
    "swapped": (columns("action", [1, 2], lambda a: a[:, ::-1]), "swapped_commands"),
    "swapped kinds": (columns("action", [0, 1], lambda a: a[:, ::-1]), "swapped_commands"),
    "degrees": (columns("action", [1, 2], np.degrees), "command_unit"),
    "lift in mm": (columns("action", [0], lambda a: 1e3 * a), "command_unit"),
    "joints in degrees": (columns("joint_position", [1, 2], np.degrees), "joint_unit"),
    "reversed": (columns("action", [2], np.negative), "reversed_commands"),
    "other zero": (columns("joint_position", [1], lambda q: q + 1.57), "zero"),
}


@pytest.mark.parametrize("fault", GRIPPER_FAULTS)
def test_a_fault_of_a_users_gripper_is_found(gripper, gripped, fault):
    change, kind = GRIPPER_FAULTS[fault]
    assert found(gripper, changed(gripper, gripped, change))[0] == (kind, True)


def test_a_frame_that_hardly_differs_is_not_refused(gripper, gripped):
    """The fingertips of this gripper close nearly along the world's axes: at most a note is due."""
    assert not any(definite for _, definite in found(gripper, changed(gripper, gripped, to_world)))


def test_sound_recordings_have_no_finding(gripper, gripped, arm, arm_episodes):
    for scene, episodes in ((gripper, gripped), (arm, arm_episodes())):
        assert found(scene, episodes) == []


@pytest.mark.parametrize("name", effect_names())
def test_no_effect_is_taken_for_a_fault(gripper, played, name):
    if not effect(name).possible(gripper):
        pytest.skip("cannot act in this scene")
    for seed in (0, 1):
        made = played(gripper, (drawn(gripper, name, seed),), count=4, seed=seed, duration_s=1.2, policies=MOTIONS)
        assert not any(definite for _, definite in found(gripper, made))


@pytest.mark.parametrize(("broken", "definite"), [(4, True), (1, False)])
@pytest.mark.parametrize("name", ["joint_position", "action"])
def test_episodes_that_are_broken_among_sound_ones_are_named(arm, arm_episodes, broken, definite, name):
    made = arm_episodes()
    bad = [Episode(e.meta, dict(e.arrays) | {name: e[name] + 2.0}) for e in made[:broken]]
    findings = mismatch(Replayer(arm), recordings(arm, [*bad, *made[broken:]]))
    (one,) = (f for f in findings if f.kind == "broken_episodes")
    assert one.definite == definite
    assert f"{broken} of 8 episodes looked at: arm-000" in one.found


@pytest.mark.parametrize(
    ("tasks", "swing", "definite"),
    [
        ("aaaabbbb", 1.0, False),
        ("abababab", 1.0, True),
        ("abcdeeee", 1.0, True),
        (("", "", "", "", *"bbbb"), 1.0, True),
        ("aaaabbbb", 0.0, True),
    ],
    ids=["by task", "in every task", "tasks of one", "unnamed", "a constant off"],
)
def test_joints_that_move_otherwise_in_all_of_a_task_and_in_no_other_may_be_too_weak_for_it(
    arm, arm_episodes, tasks, swing, definite
):
    made = [
        Episode(e.meta.model_copy(update={"task": t}), e.arrays) for e, t in zip(arm_episodes(), tasks, strict=True)
    ]
    rows = len(made[0]["time_ns"])
    other = 2.0 * (1 - swing) + swing * np.sin(np.arange(rows) / 10)[:, None]
    far = [Episode(e.meta, dict(e.arrays) | {"joint_position": e["joint_position"] + other}) for e in made[:4]]
    (one,) = (f for f in mismatch(Replayer(arm), recordings(arm, [*far, *made[4:]])) if f.kind == "broken_episodes")
    assert one.definite == definite


def test_commands_that_are_whole_steps_early_are_noted(gripper, gripped):
    ahead = changed(
        gripper, gripped, channel("action", lambda a: np.concatenate([a[3:], np.repeat(a[-1:], 3, axis=0)]))
    )
    assert found(gripper, ahead) == [("shifted_commands", False)]


def test_once_a_rival_explains_early_joints_better_no_other_is_played(gripper, gripped, monkeypatch):
    recs = recordings(gripper, gripped)
    pairs = paired(gripper, recs)
    own = recs.readings["joint_position"][..., pairs.drive.joints]
    apart = iter([1.0, 2.0, 0.9, 0.5, 3.0])  # shifted, as it is, then one rival after another
    monkeypatch.setattr(timing, "_apart", lambda *a: next(apart))
    assert timing.early_findings(timing.SampleReplay(Replayer(gripper), recs, None), pairs, own, -1.0) == []
    assert next(apart) == 3.0


def test_stronger_motors_explain_early_joints_too(gripper, gripped, monkeypatch):
    recs = recordings(gripper, gripped)
    pairs = paired(gripper, recs)
    own = recs.readings["joint_position"][..., pairs.drive.joints]
    played: list = []
    monkeypatch.setattr(
        timing.SampleReplay,
        "play",
        lambda self, recs, effects=(): played.append(effects) or {"joint_position": recs.readings["joint_position"]},
    )

    def apart(*_):  # stronger motors fit best, the shift itself fairly, all else badly
        limited = played and played[-1] and played[-1][0].name == "torque_limit"
        return 0.5 if limited else 1.0 if len(played) == 1 else 2.0

    monkeypatch.setattr(timing, "_apart", apart)
    assert timing.early_findings(timing.SampleReplay(Replayer(gripper), recs, None), pairs, own, -1.0) == []
    strongest = np.exp(candidate("torque_limit", gripper).neutral[0])
    assert played[-1][0].parameters["limit_Nm"] == pytest.approx(timing.STRONGER[0] * strongest)


def test_a_delay_of_a_step_is_physics_with_a_note(gripper, gripped):
    ahead = changed(gripper, gripped, channel("action", lambda a: np.concatenate([a[1:], a[-1:]])))
    assert found(gripper, ahead) == [("shifted_commands", False)]
    notes = checked(Replayer(gripper), recordings(gripper, ahead)).notes
    assert len(notes) == 1
    assert "one step counted wrong: `action: next` in map.yaml" in notes[0]


def test_a_refusal_says_what_was_found_and_what_to_do(gripper, gripped):
    swapped = changed(gripper, gripped, GRIPPER_FAULTS["swapped"][0])
    with pytest.raises(DataError) as caught:
        checked(Replayer(gripper), recordings(gripper, swapped))
    assert caught.value.exit_code == 2
    assert str(caught.value) == (
        "commands are in another order than the scene's actuators\n"
        "  expected: each joint follows its own command\n"
        "  found: left follows the command of right, right follows the command of left: as if these columns were "
        "exchanged, error 0.0022 instead of 0.068 rad or m\n"
        "  where: channel action\n"
        "  do: put the columns of `action` in the order of `actuators` in scene.yaml, or name them"
    )


def facing(folder: Path, episodes: Sequence[Episode]) -> tuple[Scene, list[Episode]]:
    """The same gripper with both fingers turning about one direction: one closes by growing, the other by falling."""
    text = GRIPPER.replace('axis="0 0 1" range="-.2 1.6"', 'axis="0 0 -1" range="-1.6 .2"')
    (folder / "gripper.xml").write_text(text.replace('ctrlrange="-.2 1.6"', 'ctrlrange="-1.6 .2"'))
    (folder / "scene.yaml").write_text(ROLES)
    scene = load_scene(folder / "scene.yaml")
    for name in ("joint_position", "action"):
        episodes = changed(scene, episodes, columns(name, [2], np.negative))
    return scene, list(episodes)


@pytest.mark.parametrize(
    ("name", "kind"), [("joint_position", "swapped_joints"), ("action", "swapped_commands"), (None, None)]
)
def test_joints_that_face_each_other_are_exchanged_not_reversed(tmp_path, gripped, name, kind):
    scene, episodes = facing(tmp_path, gripped)
    if name is not None:
        episodes = changed(scene, episodes, columns(name, [1, 2], lambda a: a[:, ::-1]))
    assert found(scene, episodes) == ([(kind, True)] if kind else [])


def test_a_scene_whose_joint_is_locked_is_refused(gripper, gripped, tmp_path):
    (tmp_path / "gripper.xml").write_text(GRIPPER.replace('range="-.2 1.4"', 'range="-.01 .01"'))
    (tmp_path / "scene.yaml").write_text(ROLES)
    locked = load_scene(tmp_path / "scene.yaml")
    assert found(locked, gripped)[0] == ("scene_stuck", True)


def test_nothing_that_moves_is_too_little_data(gripper, played, judge):
    made = changed(gripper, played(gripper, policies=("free_sweep",), duration_s=0.5), frozen)
    report = judge(gripper, made).report
    assert report.verdict == "too_little_data"
    assert report.effects == ()
    assert any(n.startswith("nothing moves in these recordings") for n in report.data.notes)


def test_motions_that_were_not_repeated_are_noted(gripper, gripped):
    alone = [Episode(e.meta.model_copy(update={"task": f"t{i}"}), e.arrays) for i, e in enumerate(gripped)]
    assert ("no_repeats", False) in found(gripper, alone)


def test_motors_tell_nothing_of_a_joints_place(tmp_path, gripped):
    motors = GRIPPER.replace("<position", "<motor")
    for word in ('kp="2000" kv="60"', 'kp="2.5" kv=".06"', 'kp="4" kv=".12"'):
        motors = motors.replace(word, "")
    (tmp_path / "gripper.xml").write_text(motors)
    (tmp_path / "scene.yaml").write_text(ROLES)
    scene = load_scene(tmp_path / "scene.yaml")
    swapped = changed(scene, gripped, GRIPPER_FAULTS["swapped"][0])
    assert "swapped_commands" not in [kind for kind, _ in found(scene, swapped)]


#: A bar that a weak servo hardly turns keeps its direction while the arm that carries it swings.
CARRIED = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body pos="0 0 .5"><joint name="arm" axis="0 0 1" damping=".05"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass=".6"/>
    <body pos=".3 0 0"><joint name="bar" axis="0 0 1"/>
      <geom type="capsule" fromto="-.1 0 0 .1 0 0" size=".01" mass=".3"/></body></body></worldbody>
  <actuator><position name="arm" joint="arm" kp="60" kv="3"/><position name="bar" joint="bar" kp=".0005"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("times", [1.0, 0.1])
def test_a_joint_that_runs_against_its_command_in_the_scene_too_is_not_reversed(tmp_path, times):
    (tmp_path / "carried.xml").write_text(CARRIED)
    (tmp_path / "scene.yaml").write_text(
        "model: carried.xml\nrate_hz: 100\njoints: [arm, bar]\nactuators: [arm, bar]\nnoise: {joint_position: 0.001}\n"
    )
    scene, rng = load_scene(tmp_path / "scene.yaml"), np.random.default_rng(3)
    swing = 0.4 * np.sin(np.arange(200) / 14 * rng.uniform(0.7, 1.3, (8, 1)))
    commands = np.stack([swing, times * swing], axis=2)
    played = rollout(scene, commands, *at_rest(scene, 8), [()] * 8)
    joints = add_noise(played.readings, scene.file.noise, rng)["joint_position"]
    assert np.corrcoef(joints[..., 1].ravel(), commands[..., 1].ravel())[0, 1] < -0.8
    episodes = [
        Episode(
            EpisodeMeta(id=f"e{i}", source="real", rate_hz=100.0),
            {"time_ns": np.arange(200) * 10_000_000, "action": commands[i], "joint_position": joints[i]},
        )
        for i in range(8)
    ]
    assert found(scene, episodes) == []
