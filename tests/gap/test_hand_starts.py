"""How a recording starts: what first rows tell, what settles, and what is found, against plain MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from candata.gap.data.recordings import Recordings, recordings
from candata.gap.replay.memory import ACT, lead_rows
from candata.gap.replay.replayer import Replayer, replay
from candata.gap.replay.starts import start_notes, starts
from candata.scenes import Scene, load_scene
from candata.schema.episode import Episode, EpisodeMeta

RATE_HZ, STEPS, ROWS, EPISODES = 100.0, 5, 120, 8
NOISE_RAD = 0.0005
#: Rows of the log before a recording that is cut in motion begins.
CUT = 60
LINK = '<geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".05" contype="0" conaffinity="0"/>'


def joint(name: str, inside: str = "", more: str = "") -> str:
    """A light link on a hinge; links stand side by side, so that gravity and one another do not move them."""
    hinge = f'<joint name="{name}" axis="0 0 1" damping=".02" {more}/>'
    return f'<body pos="0 {len(name) / 10} .5">{hinge}{LINK}{inside}</body>'


class Robot(NamedTuple):
    """Bodies, actuators and what stands beside them; `joints` are recorded, and driven in this order."""

    bodies: str
    actuators: str
    joints: tuple[str, ...]
    beside: str = ""


SERVO = '<position name="{0}" joint="{0}" kp="2" kv=".05" {1}/>'
PLAIN = Robot(joint("a") + joint("bb"), SERVO.format("a", "") + SERVO.format("bb", ""), ("a", "bb"))
MIMIC = Robot(
    joint("a") + joint("bb"),
    SERVO.format("a", ""),
    ("a",),
    '<equality><joint joint1="bb" joint2="a" polycoef="0.1 0.5 0 0 0"/></equality>',
)
FILTERED = Robot(joint("a"), SERVO.format("a", 'timeconst="0.05"'), ("a",))
DELAYED = Robot(joint("a"), SERVO.format("a", 'delay="0.04" nsample="20"'), ("a",))
INTEGRATING = Robot(joint("a"), '<intvelocity name="a" joint="a" kp="2" kv=".05" actrange="-2 2"/>', ("a",))
SAGGING = Robot(
    f'<body pos="0 0 .5"><joint name="flex" axis="0 1 0" stiffness="1" damping=".02"/>{LINK}'
    f'<body pos=".1 0 0"><joint name="a" axis="0 0 1" damping=".02"/>{LINK}</body></body>',
    SERVO.format("a", ""),
    ("a",),
)


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Callable[[Robot], Scene]:
    """The function that assembles a robot."""

    def assembled(robot: Robot) -> Scene:
        folder = tmp_path_factory.mktemp("robot")
        (folder / "scene.xml").write_text(
            f'<mujoco><compiler angle="radian"/><option timestep="{1 / RATE_HZ / STEPS}" integrator="implicitfast"/>'
            f"<worldbody>{robot.bodies}</worldbody><actuator>{robot.actuators}</actuator>{robot.beside}</mujoco>"
        )
        names = ", ".join(robot.joints)
        (folder / "scene.yaml").write_text(
            f"model: scene.xml\nrate_hz: {RATE_HZ:g}\njoints: [{names}]\nactuators: [{names}]\n"
            f"noise: {{joint_position: {NOISE_RAD}}}\n"
        )
        return load_scene(folder / "scene.yaml")

    return assembled


class Played(NamedTuple):
    """Recordings, and the state of plain MuJoCo at each of their rows."""

    recs: Recordings
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray


def played(scene: Scene, first: int, *, swing: float = 0.5, noise: float = NOISE_RAD) -> Played:
    """Play sines by plain MuJoCo from rest, and record from row `first` of the log on."""
    model = mujoco.MjModel.from_xml_path(str(scene.name).replace("scene.yaml", "scene.xml"))
    rng, episodes, states = np.random.default_rng(1), [], []
    joints = [model.joint(name).qposadr[0] for name in scene.file.joints]
    for e in range(EPISODES):
        data, rows = mujoco.MjData(model), []
        phase, pace = rng.uniform(0, 2 * np.pi, model.nu), rng.uniform(4, 8, model.nu)
        velocity = model.actuator_dyntype[0] == mujoco.mjtDyn.mjDYN_INTEGRATOR
        for k in range(-100, first + ROWS):
            t = max(k, 0) / RATE_HZ
            angle = swing * (np.sin(pace * t + phase) - np.sin(phase)) * min(t / 0.3, 1) + 0.3 * swing * e / EPISODES
            data.ctrl[:] = (k > 0) * swing * pace * np.cos(pace * t + phase) if velocity else angle
            if k >= first:
                rows.append((data.qpos.copy(), data.qvel.copy(), data.act.copy(), data.ctrl.copy()))
            mujoco.mj_step(model, data, STEPS)
        qpos, qvel, act, ctrl = (np.array(part) for part in zip(*rows, strict=True))
        states.append((qpos, qvel, act))
        read = qpos[:, joints] + noise * rng.standard_normal((ROWS, len(joints)))
        time_ns = np.round(np.arange(ROWS) * 1e9 / RATE_HZ).astype(np.int64)
        arrays = {"time_ns": time_ns, "joint_position": read, "action": ctrl}
        names = scene.file.joints
        meta = EpisodeMeta(id=f"e{e}", source="real", rate_hz=RATE_HZ, joint_names=names, actuator_names=names)
        episodes.append(Episode(meta, arrays))
    return Played(recordings(scene, episodes), *(np.array(part) for part in zip(*states, strict=True)))


def apart(scene: Scene, recs: Recordings) -> float:
    """Root mean square of recorded minus replayed joints, in the noise of the encoders."""
    readings = replay(Replayer(scene), recs, starts(scene, recs), [()])[0]
    difference = recs.readings["joint_position"] - readings["joint_position"]
    return float(np.sqrt(np.nanmean(difference**2)) / NOISE_RAD)


@pytest.mark.parametrize("robot", [PLAIN, MIMIC, FILTERED, DELAYED, INTEGRATING, SAGGING])
@pytest.mark.parametrize("first", [0, CUT])
def test_a_replay_of_the_scene_itself_leaves_noise_whether_it_begins_at_rest_or_is_cut(world, robot, first):
    scene = world(robot)
    # The observer follows the noise, so that a replay of the truth leaves 1.00 to 1.05; begun at rest where the
    # recording moves it left 5 to 30, with an activation of zero 10 and more.
    assert apart(scene, played(scene, first).recs) < 1.15


def test_at_rest_speeds_are_zero_and_all_rows_are_compared(world):
    scene = world(PLAIN)
    begin = starts(scene, played(scene, 0).recs)
    assert not begin.rows.any()
    assert not begin.qvel.any()
    assert start_notes(scene, begin) == ()


def test_in_motion_speeds_are_those_of_the_log_and_the_note_says_how_many_rows_tell_them(world):
    scene = world(PLAIN)
    truth = played(scene, CUT)
    begin = starts(scene, truth.recs)
    row = lead_rows(scene)
    assert (begin.rows == row).all()
    # Commands are steps, so that speed ripples within a row: at its instants it is up to a tenth below the mean.
    assert begin.qvel == pytest.approx(truth.qvel[:, row], rel=0.12, abs=0.12)
    assert np.abs(truth.qvel[:, row]).max() > 1
    (note,) = start_notes(scene, begin)
    assert note.startswith(f"{EPISODES} of {EPISODES} episodes begin in motion: their first {row} rows (50 ms)")


@pytest.mark.parametrize("first", [0, CUT])
def test_a_joint_that_is_driven_along_is_where_its_equality_holds_it(world, first):
    scene = world(MIMIC)
    truth = played(scene, first)
    begin = starts(scene, truth.recs)
    rows = np.arange(EPISODES), begin.rows
    # Constraints are soft: 10 mrad of the 300 by which the model's own start is off.
    assert begin.qpos[:, 1] == pytest.approx(truth.qpos[(*rows, 1)], abs=0.01)


@pytest.mark.parametrize("robot", [FILTERED, INTEGRATING])
@pytest.mark.parametrize("first", [0, CUT])
def test_activations_are_those_of_the_log(world, robot, first):
    scene = world(robot)
    truth = played(scene, first)
    begin = starts(scene, truth.recs)
    assert begin.memory[:, ACT] == pytest.approx(truth.act[np.arange(EPISODES), begin.rows, 0], abs=0.02)


def test_a_delay_remembers_the_commands_before_the_start(world):
    scene = world(DELAYED)
    recs = played(scene, CUT).recs
    begin, row = starts(scene, recs), lead_rows(scene)
    remembered = np.sort(begin.memory, axis=1)
    for e in range(EPISODES):
        before = recs.commands[e, row - 3 : row, 0]
        assert all(np.isclose(remembered[e], value).any() for value in before)


def test_a_passive_joint_sags_as_far_as_its_spring_lets_it(world):
    scene = world(SAGGING)
    truth = played(scene, 0)
    assert np.abs(truth.qpos[:, 0, 0]).min() > 0.05
    assert starts(scene, truth.recs).qpos[:, 0] == pytest.approx(truth.qpos[:, 0, 0], abs=2e-3)


def test_recordings_too_short_to_lead_start_at_their_first_row(world):
    scene = world(PLAIN)
    recs = played(scene, CUT).recs
    short = Recordings(
        recs.ids,
        recs.tasks,
        recs.commands[:, :6],
        {n: v[:, :6] for n, v in recs.readings.items()},
        np.full(EPISODES, 6),
        False,
    )
    assert not starts(scene, short).rows.any()


def test_a_start_of_which_nothing_was_seen_is_the_model_s(world):
    scene = world(PLAIN)
    recs = played(scene, CUT).recs
    blind = {n: np.full_like(v, np.nan) for n, v in recs.readings.items()}
    begin = starts(scene, Recordings(recs.ids, recs.tasks, recs.commands, blind, recs.lengths, False))
    assert not begin.rows.any()
    assert np.array_equal(begin.qpos[0], scene.model.qpos0)
