"""Causes that are in no library: where they act, how large they are, what they depend on, how much is closable."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from candata.effects._residual_terms import OBJECT_TERMS
from candata.gap.data.recordings import Recordings, recordings
from candata.gap.fit.folds import folds
from candata.gap.fit.problem import Problem
from candata.gap.force import remedy
from candata.gap.force.residual_force import residual_force
from candata.gap.force.stopgap import Stopgap
from candata.gap.force.suspects import suspects
from candata.gap.measure.floor import floor
from candata.gap.measure.score import score
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import layout, residual
from candata.gap.replay.starts import starts
from candata.gap.run.streams import Streams
from candata.gap.verdict import unknown_cause
from candata.gap.verdict.unknown_cause import describe
from candata.reports.files import STOPGAP, write_diagnosis
from candata.scenes import load_scene
from candata.schema.effect import EffectsFile
from candata.schema.report import Symptom
from candata.simulate import at_rest, rollout
from candata.simulate.episodes import EpisodeJob, add_noise, make_episodes
from tests.effects.gripper import ROLES, grip, write_scene
from tests.gap import hidden

#: Where a size is right: this factor either way is what is promised.
FACTOR = 1.5
NOISE = "noise: {object_pose: [0.0003, 0.003], joint_position: 0.001, fingertip_force: 0.01}\n"


@pytest.fixture(scope="module")
def gripper(tmp_path_factory):
    """Two fingers on a rail, a box on a table, with declared noise."""
    return write_scene(tmp_path_factory.mktemp("gripper"), roles=ROLES + NOISE)


@pytest.fixture(scope="module")
def hiding():
    """The function that makes a cause known to the simulator while this module's tests run: its settings."""
    with pytest.MonkeyPatch.context() as patch:
        yield hidden.hider(patch)


def grips(scene, effects, count: int = 8, seconds: float = 1.6, seed: int = 5) -> Recordings:
    """Grasps of varied force and height, recorded in a world."""
    rng = np.random.default_rng(seed)
    commands = np.concatenate([grip(seconds) * rng.uniform(0.8, 1.2, 3) for _ in range(count)])
    commands[:, :, 1:] += 0.06 * np.sin(np.arange(commands.shape[1]) / rng.uniform(3, 6, (count, 1)))[..., None]
    played = rollout(scene, commands, *at_rest(scene, count), [effects] * count)
    return Recordings(
        tuple(f"e{i}" for i in range(count)),
        ("grip",) * count,
        commands,
        add_noise(played.readings, scene.file.noise, rng),
        np.full(count, commands.shape[1]),
        False,
    )


def described(scene, recs, world=(), where=()):
    """What is said of a recording's unknown cause."""
    rng = np.random.default_rng(1)
    replayer, begin = Replayer(scene), starts(scene, recs)
    nominal = replay_all(replayer, recs, begin, [world])[0]
    plan = layout(scene, recs, begin, nominal)
    spread = floor(replayer, recs, begin, plan, scene.file.noise, rng, 4, world)
    raw = residual(recs, plan, nominal)
    no_library = SimpleNamespace(take=lambda index: None)
    problem = Problem(
        replayer,
        recs,
        begin,
        plan,
        score(raw, spread, plan),
        folds(recs.tasks, rng),
        scene.file.noise,
        "declared",
        Streams(1),
        no_library,
        nominal,
        raw,
    )
    return describe(problem, world, where, None)


@pytest.fixture(scope="module")
def cogging(arm, arm_episodes, hiding):
    cause = hidden.on_joint("elbow", lambda q, u, memory: 0.3 * np.sin(12 * q + 0.4))
    return described(arm, recordings(arm, arm_episodes(hiding(cause))))


def near(size: float) -> object:
    return pytest.approx(size, rel=FACTOR - 1)


def test_a_cogging_torque_is_found_in_its_joint(cogging):
    found = cogging.unknown
    assert (found.acts_on, found.element, found.unit) == ("joint", "elbow", "N m")
    assert found.depends_on == ("position",)
    # The median of a sine above a quarter of its height.
    assert found.size == near(0.3 * 0.76)
    assert found.words.startswith("A torque of about 0.2")
    assert "on joint elbow that repeats with its position every 0.52 rad" in found.words


def test_the_stop_gap_of_a_cogging_torque_closes_the_gap(cogging):
    # The dictionary holds this very law.
    assert cogging.unknown.closable > 0.9
    assert [(s.name, s.element) for s in cogging.stopgap] == [("learned_residual", "elbow")]


@pytest.mark.parametrize(
    ("little", "channel", "place"),
    [(-1.0, "fingertip_force", "joint"), (1.0, "fingertip_force", None), (1.0, "joint_position", "joint")],
)
def test_where_a_force_mends_nothing_the_symptoms_say_on_what_it_acts(
    arm, arm_episodes, hiding, monkeypatch, little, channel, place
):
    """No fingertip stands out: then nothing is described."""
    monkeypatch.setattr(unknown_cause, "LITTLE", little)
    cause = hidden.on_joint("elbow", lambda q, u, memory: 0.3 * np.sin(12 * q + 0.4))
    worst = Symptom(channel=channel, element="elbow", ratio=9.0, p=0.001)
    found = described(arm, recordings(arm, arm_episodes(hiding(cause))), where=(worst,))
    assert (found.unknown.acts_on if found else None) == place
    assert found is None or found.unknown.element == "elbow"


def test_with_the_cause_switched_off_nothing_stands_out(arm, arm_episodes):
    assert described(arm, recordings(arm, arm_episodes())) is None


@pytest.mark.parametrize(
    ("name", "value", "size"),
    [
        ("joint_damping", {"damping_Nms_rad": 0.4}, np.nanstd),
        # A sensor at fault is no force: the true joints are pulled, and compared with the true ones.
        ("joint_offset", {"offset_rad": 0.2}, lambda force: abs(np.nanmean(force))),
    ],
)
def test_a_cause_that_the_world_holds_leaves_nothing(arm, arm_episodes, planted, name, value, size):
    effects = planted(name, "elbow", **value)
    recs = recordings(arm, arm_episodes(effects))
    begin = starts(arm, recs)
    before, after = (residual_force(Replayer(arm), recs, begin, world).force for world in ((), effects))
    assert size(after[:, :, 1]) < 0.5 * size(before[:, :, 1])


def test_a_motor_that_fades_with_use_is_found(arm, arm_episodes, hiding):
    def fade(q, u, memory):
        memory["use"] = memory.get("use", 0) + np.abs(u) / 100
        return -u * (1 - np.exp(-0.5 * memory["use"]))

    found = described(arm, recordings(arm, arm_episodes(hiding(hidden.on_joint("shoulder", fade))))).unknown
    assert (found.acts_on, found.element, found.unit) == ("joint", "shoulder", "N m")
    assert {"memory", "load"} & set(found.depends_on)


def test_friction_that_grows_with_the_load_is_found(arm, arm_episodes, hiding):
    cause = hidden.on_joint("shoulder", hidden.stiction(0.5, 0.005))
    found = described(arm, recordings(arm, arm_episodes(hiding(cause)))).unknown
    assert (found.acts_on, found.element) == ("joint", "shoulder")
    assert found.depends_on[0] == "sign of velocity"


def test_a_cause_in_every_joint_is_no_single_joint_s(arm, arm_episodes, hiding):
    def sticky(scene, memory, x):
        return -0.4 * np.abs(x.effort) * np.tanh(x.qvel / 0.3)

    found = described(arm, recordings(arm, arm_episodes(hiding(hidden.force(sticky)))))
    assert (found.unknown.acts_on, found.unknown.element) == ("joint", None)
    assert {s.element for s in found.stopgap} == {"shoulder", "elbow"}


def test_a_spring_on_a_slide_is_the_wrist_s(gripper, hiding):
    found = described(gripper, grips(gripper, hiding(hidden.on_joint("lift", lambda q, u, memory: -300 * q)))).unknown
    assert (found.acts_on, found.element, found.unit) == ("wrist", "lift", "N")


def test_a_wind_on_the_object_is_a_pull_in_its_direction(gripper, hiding):
    found = described(gripper, grips(gripper, hiding(hidden.on_object((0.0, 0.25, 0.0))))).unknown
    assert (found.acts_on, found.element, found.unit) == ("object", None, "N")
    assert found.size == near(0.25)
    assert "on the object towards +y" in found.words


def drawn_down(pull: float, fades: float):
    """A cause that pulls the object onto its support [N], less and less over a height [m]."""

    def drawn(scene, memory, x):
        out, height = np.zeros_like(x.added), x.qpos[:, scene.object_qpos + 2]
        rest = memory.setdefault("rest", height.copy())
        out[:, scene.object_dof + 2] = -pull * np.exp(-np.maximum(height - rest, 0) / fades)
        return out

    return hidden.force(drawn)


def test_a_pull_that_fades_with_height_is_told_from_a_weight(gripper, hiding):
    """On its support the object shows nothing of it; in the air a constant pull would fit its size, not its motion."""
    found = described(gripper, grips(gripper, hiding(drawn_down(1.2, 0.012))))
    assert found.unknown.acts_on == "object"
    assert found.unknown.depends_on[0] == "nearness to the support"
    assert "on the object towards -z that fades with its height above the table" in found.unknown.words
    assert found.unknown.closable > 0.7


def test_a_pull_on_what_is_dragged_and_not_lifted_is_found_by_playing_it(hiding):
    """The support takes it: all that a residual force shows of it is friction, which closes 0.07 of the gap."""
    scene = load_scene("gripper_tabletop")
    world = hiding(drawn_down(1.8, 0.02))
    squeezes = make_episodes(scene, [EpisodeJob(f"e{i}", i, "squeeze", 3, world) for i in range(8)], duration_s=2.4)
    found = described(scene, recordings(scene, squeezes)).unknown
    assert (found.acts_on, found.depends_on) == ("object", ("nearness to the support",))
    assert "on the object towards -z that fades with its height above the table" in found.words
    assert found.size == near(1.8)
    assert found.closable > 0.8


def test_a_sensor_with_hysteresis_is_a_reading_and_no_force(gripper, hiding):
    found = described(gripper, grips(gripper, hiding(hidden.hysteresis("left", 0.4))))
    assert (found.unknown.acts_on, found.unknown.element, found.unknown.unit) == ("fingertip", "left", "N")
    assert found.unknown.words.startswith("An error of the reading, nothing in the motion")
    assert found.stopgap == ()


def test_skins_that_creep_are_readings_that_remember_their_load(gripper, hiding):
    """Both fingertips: a correction of one alone would leave half."""

    def creeping(scene, memory, readings):
        now = readings["fingertip_force"]
        past = memory.get("past", np.zeros_like(now))
        memory["past"] = past + (now - past) / (0.7 * scene.file.rate_hz)
        return {**readings, "fingertip_force": now + 0.5 * memory["past"]}

    found = described(gripper, grips(gripper, hiding(hidden.reading(creeping))))
    assert found.unknown.acts_on == "fingertip"
    assert found.unknown.element is None
    assert {"memory", "load"} <= set(found.unknown.depends_on)
    assert found.unknown.words.startswith("An error of the reading, nothing in the motion")
    assert "(and others on" in found.unknown.words
    assert found.unknown.closable > 0.5


def test_the_residual_force_is_what_was_added(arm, arm_episodes, hiding):
    cause = hidden.on_joint("elbow", lambda q, u, memory: np.full_like(q, 0.2))
    recs = recordings(arm, arm_episodes(hiding(cause)))
    force = residual_force(Replayer(arm), recs, starts(arm, recs)).force
    # After the settling of the first tenth of a second; 1 mrad of noise under a servo of 15 N m/rad is 15 mN m a row.
    assert np.nanmean(force[:, 20:, 1]) == pytest.approx(0.2, abs=0.01)
    assert np.nanmean(force[:, 20:, 0]) == pytest.approx(0.0, abs=0.01)


def test_what_the_support_takes_is_not_known(gripper):
    recs = grips(gripper, ())
    seen = residual_force(Replayer(gripper), recs, starts(gripper, recs))
    pull = next(
        s
        for s in suspects(gripper, seen, seen, folds(recs.tasks, np.random.default_rng(0)))
        if s.place == "object" and s.axes.start == 0
    )
    off = pull.sample.terms[:, :, 2, OBJECT_TERMS.index(("off the support",))]
    known = np.isfinite(pull.sample.force)
    assert set(off[known[..., 2]]) == {1.0}, "downwards only in the air"
    assert (off[known[..., 0]] < 1).any(), "sideways on the support too, while it is touched"


JAWS = """<mujoco><option timestep="0.002"/><worldbody>
<body pos="-.02 0 .3"><joint name="left" type="slide" axis="1 0 0" damping="5"/>
  <geom name="left_tip" type="sphere" size=".015" mass=".1"/></body>
<body pos=".02 0 .3"><joint name="right" type="slide" axis="-1 0 0" damping="5"/>
  <geom name="right_tip" type="sphere" size=".015" mass=".1"/></body></worldbody>
<actuator><motor name="left" joint="left"/><motor name="right" joint="right"/></actuator></mujoco>"""


def test_a_fingertip_that_feels_more_without_an_object_is_held_by_its_joint(tmp_path):
    (tmp_path / "jaws.xml").write_text(JAWS)
    (tmp_path / "scene.yaml").write_text(
        "model: jaws.xml\nrate_hz: 100\njoints: [left, right]\nactuators: [left, right]\n"
        "fingertips: [left_tip, right_tip]\n"
    )
    jaws, count, rows = load_scene(tmp_path / "scene.yaml"), 2, 60
    commands = np.full((count, rows, 2), 3.0)
    readings = rollout(jaws, commands, *at_rest(jaws, count), [()] * count).readings
    readings = {name: readings[name] for name in ("joint_position", "fingertip_force")}
    readings["fingertip_force"][:, 20:, 0, 0] += 1.0  # [N], on the left one alone, and nothing moves
    recs = Recordings(("a", "b"), ("push",) * count, commands, readings, np.full(count, rows), False)
    force = residual_force(Replayer(jaws), recs, starts(jaws, recs)).force
    # Smoothing spreads the step over the rows about it.
    assert np.nanmean(force[:, 30:50, 0]) == pytest.approx(-1.0, abs=0.05)
    assert np.nanmean(force[:, 30:50, 1]) == pytest.approx(0.0, abs=0.05)


def test_rows_that_were_not_recorded_are_not_known(arm, arm_episodes):
    recs = recordings(arm, arm_episodes())
    recs.readings["joint_position"][2, 50:60, 1] = np.nan
    force = residual_force(Replayer(arm), recs, starts(arm, recs)).force
    assert np.isnan(force[2, 50:60, 1]).all()
    assert np.isfinite(force[2, 50:60, 0]).all()
    assert np.isnan(force[:, :, 2:]).all(), "there is no object"


@pytest.mark.slow
def test_a_diagnosis_names_nothing_says_where_and_writes_a_simulator_that_runs(
    arm,
    arm_episodes,
    judge,
    hiding,
    tmp_path,
):
    cause = hidden.on_joint("elbow", lambda q, u, memory: 0.3 * np.sin(12 * q + 0.4))
    found = judge(arm, arm_episodes(hiding(cause)))
    report = found.report
    assert (report.verdict, report.effects) == ("unknown_effect", ())
    assert (report.unknown.acts_on, report.unknown.element) == ("joint", "elbow")
    assert "which does not explain it" in report.unknown.words
    write_diagnosis(found, arm, tmp_path)
    assert yaml.safe_load((tmp_path / "effects.yaml").read_text())["effects"] == []
    stopgap = EffectsFile.model_validate(yaml.safe_load((tmp_path / STOPGAP).read_text()))
    recs = recordings(arm, arm_episodes(hiding(cause), seed=2))
    errors = [
        np.nanmean(np.abs(recs.readings["joint_position"] - r["joint_position"]))
        for r in replay_all(Replayer(arm), recs, starts(arm, recs), [(), stopgap.effects])
    ]
    # On motions it has not seen; the noise alone is a part of what remains.
    assert errors[1] < 0.5 * errors[0]


def played(monkeypatch, closes: dict[tuple[str, ...], float], others=()):
    """The function that chooses among suspects of which groups close what is given, by their names."""
    monkeypatch.setattr(remedy, "otherwise", lambda suspect, parts: list(others))

    def play(some):
        return SimpleNamespace(suspects=tuple(some), closed=closes[tuple(s.name for s in some)])

    return lambda found: [s.name for s in remedy._best(play, found, []).suspects]


def suspect(place: str, name: str, gain: float = 1.0):
    return SimpleNamespace(place=place, name=name, gain=gain)


def test_what_acts_in_several_places_is_not_lost_to_one_place_that_closes_more_than_each(monkeypatch):
    closes = {("a",): 0.1, ("b",): 0.13, ("tip",): 0.2, ("a", "b"): 0.8}
    found = [suspect("joint", "a"), suspect("joint", "b"), suspect("fingertip", "tip")]
    assert played(monkeypatch, closes)(found) == ["a", "b"]
    assert played(monkeypatch, closes | {("a", "b"): 0.24})(found) == ["tip"]


def test_the_most_telling_suspect_of_each_place_is_played(monkeypatch):
    """A wind on what three fingers hold changes what each of them reads, and stood behind all three."""
    tips = [suspect("fingertip", name, gain) for name, gain in (("a", 1.0), ("b", 0.98), ("c", 0.98))]
    closes = {("a",): 0.05, ("b",): 0.03, ("wind",): 0.9, ("a", "b", "c"): 0.13}
    assert played(monkeypatch, closes)([*tips, suspect("object", "wind", 0.87)]) == ["wind"]
    others = [suspect("joint", "hinge", 0.9), suspect("wrist", "rail", 0.89), suspect("object", "wind", 0.87)]
    assert played(monkeypatch, closes | {("hinge",): 0.1, ("rail",): 0.1})([*tips, *others]) == ["wind"]


def test_a_plainer_description_is_taken_where_it_closes_more(monkeypatch):
    found = [suspect("object", "steady")]
    for closable, taken in ((0.6, "fading"), (0.52, "steady")):
        choose = played(monkeypatch, {("steady",): 0.5, ("fading",): closable}, [suspect("object", "fading")])
        assert choose(found) == [taken]


@pytest.mark.parametrize(("scale", "after", "closed"), [(1.0, 1.5, 0.5), (0.0, 1.5, 0.0), (0.0, 2.5, -0.5)])
def test_a_force_that_all_episodes_ask_none_of_closes_nothing(scale, after, closed):
    """What the folds' own forces close then is luck, and of no force there is no typical size."""
    found = Stopgap((), scale, (), np.ones(4), np.full(4, after), np.full(4, 2.0))
    assert found.closed == pytest.approx(closed)


def test_what_a_joints_force_also_depends_on_is_said_in_the_same_clause():
    found = SimpleNamespace(terms=[0], coefficients=np.array([[-0.02]]))
    drag = SimpleNamespace(place="joint", description=found, names=(("velocity",),), wave=1.0, depends_on=("velocity",))
    both = SimpleNamespace(**{**vars(drag), "depends_on": ("velocity", "position", "constant")})
    alone, more = (unknown_cause._how(SimpleNamespace(suspects=(s,))) for s in (drag, both))
    assert alone == " against its motion, growing with speed"
    assert more == f"{alone}, depending also on position"
