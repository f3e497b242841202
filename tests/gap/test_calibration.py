"""Calibration: a servo that is wrong in six quantities at once, which no search of single causes repairs."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from scipy.optimize import least_squares

from candata.effects import effect_names, read_effects
from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidates
from candata.gap.fit.problem import Problem
from candata.gap.fit.stage import Stage
from candata.gap.fit.world_floor import in_world
from candata.gap.preparation import _problem
from candata.gap.replay.budget import Budget, BudgetSpent
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.search.attribution import Attribution
from candata.gap.search.joint_fit import joint_fit
from candata.gap.validation.closure import held_out
from candata.gap.verdict.calibration import NO_BUDGET, with_calibration
from candata.gap.verdict.figures import Evidence
from candata.gap.verdict.findings import Diagnosis, Findings
from candata.repair import export_mjcf
from candata.reports import summary, write_diagnosis
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting, EffectsFile
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.report import DiagnosisData, EpisodeCount, Gap, Report
from candata.simulate import at_rest, rollout
from candata.simulate.episodes import add_noise

HZ, NOISE_RAD = 100.0, 0.0005
PENDULUM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body name="arm" pos="0 0 .5"><joint name="hinge" axis="0 1 0" damping=".02" armature=".002"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.1" size=".006" mass=".02"/>
    <geom type="sphere" pos="0 0 -.1" size=".02" mass=".3"/></body></worldbody>
  <actuator><position name="hinge" joint="hinge" kp="2" kv=".05" forcerange="-.6 .6"/></actuator></mujoco>
"""
ROLES = """model: pendulum.xml
rate_hz: 100
joints: [hinge]
actuators: [hinge]
noise: {joint_position: 0.0005}
"""
#: What is wrong, by 30 to 180 % of the scene's own numbers.
WRONG = {
    "actuation_delay": {"delay_s": 0.04},
    "servo_gain": {"kp_scale": 1.6},
    "torque_limit": {"limit_Nm": 0.4},
    "joint_damping": {"damping_Nms_rad": 0.03},
    "joint_dry_friction": {"frictionloss_Nm": 0.05},
    "armature": {"armature_kgm2": 0.003},
}
#: Quantities that are right and may be fitted all the same.
SOUND = ("joint_offset", "servo_damping")


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory) -> Scene:
    """A weight on a position servo."""
    folder = tmp_path_factory.mktemp("pendulum")
    (folder / "pendulum.xml").write_text(PENDULUM)
    (folder / "scene.yaml").write_text(ROLES)
    return load_scene(folder / "scene.yaml")


def settings(values: dict[str, dict[str, float]]) -> tuple[EffectSetting, ...]:
    return tuple(EffectSetting(name=name, parameters=x) for name, x in values.items())


def motions(count: int = 8, rows: int = 150, seed: int = 2) -> np.ndarray:
    """Sines, slow and fast in turn, and square waves, `(count, rows, 1)`."""
    rng = np.random.default_rng(seed)
    t = (np.arange(rows) / HZ)[None, :, None]
    slow, fast = rng.uniform(0.3, 0.8, count), rng.uniform(1.0, 2.5, count)
    rate = np.where(np.arange(count) % 2 == 0, slow, fast)[:, None, None]
    size, phase = rng.uniform(0.4, 1.4, (count, 1, 1)), rng.uniform(0, 6, (count, 1, 1))
    commands = np.clip((t - 0.1) / 0.2, 0, 1) * size * np.sin(2 * np.pi * rate * t * (1 + 0.2 * t) + phase)
    square = np.where(np.sin(2 * np.pi * rate * t + phase) > 0, 1, -1) * size * np.clip((t - 0.1) / 0.05, 0, 1)
    commands[::3] = square[::3]
    return commands


def played(scene: Scene, commands: np.ndarray, effects=()) -> np.ndarray:
    """Joint positions `(E, T)` [rad] of a free run from rest."""
    count = len(commands)
    return rollout(scene, commands, *at_rest(scene, count), [effects] * count).readings["joint_position"][..., 0]


def episodes(scene: Scene, effects=()) -> list[Episode]:
    commands = motions()
    truth = {"joint_position": played(scene, commands, effects)[..., None]}
    positions = add_noise(truth, scene.file.noise, np.random.default_rng(1))["joint_position"]
    names = {"joint_names": ("hinge",), "actuator_names": ("hinge",)}
    time_ns = np.arange(commands.shape[1]) * round(1e9 / HZ)
    return [
        Episode(
            EpisodeMeta(id=f"e{i}", source="real", rate_hz=HZ, task=("slow", "fast")[i % 2], **names),
            {"time_ns": time_ns, "joint_position": positions[i], "action": commands[i]},
        )
        for i in range(len(commands))
    ]


def findings_of(scene: Scene, effects) -> Findings:
    """What a search that explains nothing leaves, after many replays."""
    recs = recordings(scene, episodes(scene, effects))
    problem = _problem(Replayer(scene), recs, Streams(0), None, lambda stage: None)
    problem = replace(problem, ruled_out=frozenset(effect_names()) - {*WRONG, *SOUND})
    problem.sofar.episodes_replayed = 1200 * len(recs)
    base = problem.score.loss(problem.nominal)
    first = Stage(base, np.zeros((1, len(base))), (), inf, (), (), (), 0.0)
    found = Attribution(first, None, (), problem.score, True)
    return Findings(None, scene, problem, found, problem, held_out(problem, None), len(recs))


def concluded_as(verdict: str, findings: Findings, effects=()) -> Diagnosis:
    data = DiagnosisData(dataset="real", episodes=EpisodeCount(total=8, folds=4, held_out=8))
    report = Report(verdict=verdict, data=data, gap=Gap(before=9, after=9, closed=0, low=0, high=0))
    return Diagnosis(report, Evidence(), EffectsFile(scene=findings.scene.name, effects=effects))


def measure_in(problem: Problem):
    return lambda fit: held_out(in_world(problem, fit.members), fit)


@pytest.fixture(scope="module")
def wrong(pendulum) -> Findings:
    return findings_of(pendulum, settings(WRONG))


@pytest.fixture(scope="module")
def calibrated(wrong) -> Diagnosis:
    return with_calibration(wrong, concluded_as("unknown_effect", wrong), measure_in(wrong.problem))


def test_all_that_is_wrong_and_nothing_else_is_calibrated_to_near_the_noise(calibrated):
    record = calibrated.report.calibration
    values = {e.name: e.parameters for e in record.effects}
    assert set(values) == set(WRONG)
    for name, true in WRONG.items():
        for parameter, value in true.items():
            assert values[name][parameter] == pytest.approx(value, rel=0.1), "a tenth is near for a repair"
    assert record.gap.before > 100
    assert record.gap.after < 2, "floors; noise alone gives one"
    assert (record.numbers, record.combinations) == (6, 6)


def test_a_calibration_runs_free_on_unseen_motions_no_worse_than_plain_least_squares(pendulum, calibrated):
    """Plain: the same quantities fitted from the scene's own values to free runs of all recordings."""
    commands, unseen = motions(), motions(count=6, seed=7)
    recorded = np.stack([e["joint_position"][:, 0] for e in episodes(pendulum, settings(WRONG))])
    ranges = {"actuation_delay": (0, 0.1), "servo_gain": (0.5, 3), "torque_limit": (0.1, 1.2)}
    ranges |= {"joint_damping": (0, 0.1), "joint_dry_friction": (0, 0.2), "armature": (0, 0.02)}
    names = [(name, *WRONG[name]) for name in ranges]
    neutral, (low, high) = [0, 1, 0.6, 0, 0, 0.0], np.array(list(ranges.values())).T

    def world(x):
        return tuple(EffectSetting(name=n, parameters={p: float(v)}) for (n, p), v in zip(names, x, strict=True))

    plain = least_squares(
        lambda x: (played(pendulum, commands, world(x)) - recorded).ravel(),
        neutral,
        bounds=(low, high),
        x_scale=high - low,
        diff_step=0.01,
        max_nfev=12,
    )
    truth = played(pendulum, unseen, settings(WRONG))
    effects = calibrated.report.calibration.effects
    nominal, fitted, least = (
        np.sqrt(((played(pendulum, unseen, some) - truth) ** 2).mean()) for some in ((), effects, world(plain.x))
    )
    assert fitted <= max(least, NOISE_RAD / 10), "a tenth of one reading's noise counts as none"
    assert fitted < 0.02 * nominal


def test_the_calibration_is_a_file_that_says_what_it_is_and_can_be_exported(pendulum, calibrated, tmp_path):
    write_diagnosis(calibrated, pendulum, tmp_path)
    path = tmp_path / "calibration.yaml"
    text = " ".join(line.removeprefix("# ") for line in path.read_text().splitlines() if line.startswith("#"))
    assert "closes 100 % of the gap on held-out episodes (90 % interval" in text
    effects = read_effects(path).effects
    assert effects == calibrated.report.calibration.effects
    assert read_effects(tmp_path / "effects.yaml").effects == ()
    written = load_scene(export_mjcf(pendulum, effects, tmp_path / "out").folder + "/scene.yaml")
    scale = {e.name: e.parameters for e in effects}["servo_gain"]["kp_scale"]
    assert written.model.actuator_gainprm[0, 0] == pytest.approx(2 * scale, rel=1e-4)
    assert "calibrated calibration.yaml closes" in summary(calibrated.report)
    write_diagnosis(replace(calibrated, calibration=None), pendulum, tmp_path)
    assert not path.exists(), "that of an earlier diagnosis goes"


def test_nothing_is_calibrated_where_nothing_is_wrong(pendulum):
    findings = findings_of(pendulum, ())
    diagnosis = concluded_as("unknown_effect", findings)
    assert with_calibration(findings, diagnosis, measure_in(findings.problem)) is diagnosis


@pytest.mark.parametrize("verdict", ["no_gap", "explained", "ambiguous"])
def test_other_verdicts_get_no_calibration(wrong, verdict):
    diagnosis = concluded_as(verdict, wrong)
    assert with_calibration(wrong, diagnosis, measure_in(wrong.problem)) is diagnosis


def test_a_spent_budget_leaves_the_verdict_as_it_is_and_a_note(wrong):
    def spent(steps: int) -> None:
        raise BudgetSpent(Budget(1.0))

    problem = replace(wrong.problem, replayer=replace(wrong.problem.replayer, count=spent), played={})
    diagnosis = concluded_as("unknown_effect", wrong)
    noted = with_calibration(replace(wrong, problem=problem), diagnosis, measure_in(problem))
    assert noted.report.calibration is None
    assert noted.report.data.notes == (NO_BUDGET,)


def test_a_fit_that_was_judged_is_kept_where_the_replays_end(wrong):
    """Idle quantities and all: nothing is left to fit the others again without them."""
    possible = candidates(wrong.scene, wrong.problem.recs.channels)
    kinds = [c for c in possible if not c.choices and c.name in {*WRONG, *SOUND}]
    fitted = joint_fit(replace(wrong.problem, streams=Streams(0)), kinds, (), 80.0)
    assert fitted is not None
    assert fitted.fit.gain > 0.2 * wrong.problem.score.loss(wrong.problem.nominal).mean()
    assert set(SOUND) & {c.name for c, _ in fitted.fit.members}


def test_a_calibration_takes_no_more_replays_than_a_third_of_all(wrong):
    """A part of what came before is less than a third of the whole."""
    steps = []
    fresh = replace(wrong.problem, replayer=replace(wrong.problem.replayer, count=steps.append), played={})
    fresh.sofar.episodes_replayed = 60 * len(fresh.recs)
    with_calibration(replace(wrong, problem=fresh), concluded_as("unknown_effect", wrong), lambda fit: wrong.held)
    one_replay = fresh.recs.commands.shape[0] * fresh.recs.commands.shape[1] * fresh.replayer.scene.substeps
    assert 0 < sum(steps) <= 15 * one_replay
