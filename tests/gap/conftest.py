"""Small, fast worlds: a two-joint arm of a user's, the built-in scenes, and recordings made in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.gap import Diagnosis, diagnose
from candata.gap.data.recordings import Recordings, recordings
from candata.gap.fit.candidates import candidate, candidates
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.problem import Problem
from candata.gap.measure.floor import Floor
from candata.gap.measure.score import Score, score
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import Layout, residual
from candata.gap.run.streams import Streams
from candata.gap.screening.look import as_simulated, look
from candata.gap.screening.refinement import joint
from candata.gap.screening.sums import Responses
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from candata.simulate import at_rest, rollout
from candata.simulate.episodes import EpisodeJob, add_noise, make_episodes

#: Rate of the arm's scene.
ARM_HZ = 100.0
ARM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body name="upper" pos="0 0 .5"><joint name="shoulder" axis="0 0 1" damping=".05"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass=".6"/>
    <body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 0 1" damping=".05"/>
      <geom type="capsule" fromto="0 0 0 .25 0 0" size=".025" mass=".4"/></body></body></worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="30" kv="1.5" forcerange="-4 4"/>
    <position name="elbow" joint="elbow" kp="15" kv=".6" forcerange="-3 3"/>
  </actuator></mujoco>
"""
ROLES = """model: arm.xml
rate_hz: 100
joints: [shoulder, elbow]
actuators: [shoulder, elbow]
noise: {joint_position: 0.001}
"""

#: Effects of links and servos that act much like others on this arm, which has no gravity to tell them by. Tests of
#: single steps of the search leave them out, as `ruled_out` of their problem.
ALIKE = frozenset(
    (
        *("link_mass", "link_com", "link_inertia", "joint_spring", "servo_punch", "servo_dead_band"),
        *("drive_voltage", "back_emf", "speed_limit", "stribeck", "load_friction"),
    )
)


def step_problem(arm: Scene, recs: Recordings) -> Problem:
    """The problem that recordings of the arm pose to a single step of the search, without `ALIKE`."""
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    return replace(problem, ruled_out=ALIKE)


@pytest.fixture(scope="session")
def arm(tmp_path_factory) -> Scene:
    """Two driven hinges that turn about the vertical; no object, no forces."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.xml").write_text(ARM)
    (folder / "scene.yaml").write_text(ROLES)
    return load_scene(folder / "scene.yaml")


@pytest.fixture(scope="session")
def hand() -> Scene:
    return load_scene("xhand_tabletop")


@pytest.fixture(scope="session")
def cube() -> Scene:
    return load_scene("cube_toss")


def plant(name: str, /, element: str | None = None, **parameters: object) -> tuple[EffectSetting, ...]:
    return (EffectSetting(name=name, element=element, parameters=parameters),)


@pytest.fixture(scope="session")
def planted() -> Callable[..., tuple[EffectSetting, ...]]:
    """The function that makes a set of one effect."""
    return plant


@pytest.fixture(scope="session")
def arm_episodes(arm) -> Callable[..., list[Episode]]:
    """The function that records the arm: sines that start at rest and rise in frequency."""

    def make(effects=(), count: int = 8, rows: int = 160, seed: int = 1, noise: bool = True) -> list[Episode]:
        rng = np.random.default_rng(seed)
        t = (np.arange(rows) / ARM_HZ)[None, :, None]
        rate, size, phase = (rng.uniform(*span, (count, 1, 2)) for span in ((0.4, 1.6), (0.3, 0.7), (0, 6.0)))
        commands = np.clip((t - 0.1) / 0.2, 0, 1) * size * np.sin(2 * np.pi * rate * t * (1 + 0.4 * t) + phase)
        played = rollout(arm, commands, *at_rest(arm, count), [effects] * count)
        readings = add_noise(played.readings, arm.file.noise if noise else None, rng)
        return [
            Episode(
                EpisodeMeta(
                    id=f"arm-{i:03d}",
                    source="real",
                    rate_hz=ARM_HZ,
                    task=("slow", "fast")[i % 2],
                    joint_names=arm.file.joints,
                    actuator_names=arm.file.actuator_names,
                ),
                {
                    "time_ns": np.arange(rows) * round(1e9 / ARM_HZ),
                    "joint_position": readings["joint_position"][i],
                    "action": commands[i],
                },
            )
            for i in range(count)
        ]

    return make


@pytest.fixture(scope="session")
def played() -> Callable[..., list[Episode]]:
    """The function that records built-in motions in a scene."""

    def make(
        scene: Scene,
        effects=(),
        count: int = 8,
        duration_s: float = 1.6,
        seed: int = 3,
        policies: Sequence[str] = (),
        noise: bool = True,
    ) -> list[Episode]:
        some = policies or scene.policies
        jobs = [EpisodeJob(f"e{i:03d}", i, some[i % len(some)], seed, effects, hidden=True) for i in range(count)]
        return make_episodes(scene, jobs, duration_s=duration_s, noise=scene.file.noise if noise else None)

    return make


@pytest.fixture(scope="session")
def as_dataset(tmp_path_factory):
    """The function that writes episodes into a dataset."""

    def make(episodes: Sequence[Episode]):
        folder = tmp_path_factory.mktemp("set") / "real"
        create_dataset(folder)
        if episodes:
            append(folder, episodes, Lineage(operation="test"))
        return open_dataset(folder)

    return make


@pytest.fixture(scope="session")
def judge(as_dataset) -> Callable[..., Diagnosis]:
    """The function that diagnoses episodes in a scene."""
    return lambda scene, episodes, **options: diagnose(as_dataset(episodes), scene, calibrate=False, **options)


@pytest.fixture(scope="session")
def plain_recordings() -> Callable[..., Recordings]:
    """The function that makes recordings of arrays, one row each if not said otherwise."""

    def make(commands=None, lengths=None, tasks=None, instant: bool = False, **readings) -> Recordings:
        first = next(iter(readings.values()))
        count, rows = first.shape[:2]
        return Recordings(
            tuple(f"e{i}" for i in range(count)),
            tasks or ("",) * count,
            np.zeros((count, rows, 0)) if commands is None else commands,
            readings,
            np.full(count, rows) if lengths is None else np.asarray(lengths),
            instant,
        )

    return make


@pytest.fixture(scope="session")
def one_phase() -> Callable[..., Layout]:
    """The function that makes a layout of D joints in which every block has a phase by turns."""

    def make(episodes: int, blocks: int, columns: int, phases: tuple[str, ...] = ("free",)) -> Layout:
        named = tuple(("joint_position", f"j{i}", "rad") for i in range(columns))
        phase = np.tile(np.arange(blocks) % len(phases), (episodes, 1))
        return Layout(named, phases, phase, 5)

    return make


@pytest.fixture(scope="session")
def white_score(one_phase) -> Callable[..., Score]:
    """The function that makes the score of E episodes of K values whose nulls are white with unit spread."""

    def make(
        rng: np.random.Generator, episodes: int = 8, size: int = 40, replicas: int = 16, columns: int = 1
    ) -> Score:
        shape = (episodes, size // columns, columns)
        spread = Floor(np.ones(shape), rng.standard_normal((replicas, *shape)))
        return score(np.zeros(shape), spread, one_phase(episodes, *shape[1:]))

    return make


def members(arm: Scene, **values: float) -> Members:
    """Scalar effects at their values, as the members of a set."""
    return tuple((candidate(name, arm), np.full(1, value)) for name, value in values.items())


#: Effects that tests of the search leave to it, so that they are quick.
SEARCHED = frozenset(
    (
        *("joint_dry_friction", "joint_damping", "armature", "actuation_delay", "servo_damping", "servo_gain"),
        *("joint_offset", "time_step"),
    )
)


@pytest.fixture(scope="session")
def arm_search(arm, arm_episodes) -> Callable[..., tuple[Problem, Responses]]:
    """The function that poses the problem of an arm with effects to a search, and looks at each of `SEARCHED` alone."""

    posed: dict[str, tuple[Problem, Responses]] = {}

    def pose(*effects: EffectSetting) -> tuple[Problem, Responses]:
        if repr(effects) not in posed:
            posed[repr(effects)] = make(effects)
        return posed[repr(effects)]

    def make(effects: Sequence[EffectSetting]) -> tuple[Problem, Responses]:
        problem = step_problem(arm, recordings(arm, arm_episodes(effects, count=12, rows=120)))
        others = {c.name for c in candidates(arm, problem.recs.channels)} - SEARCHED
        problem = replace(problem, ruled_out=problem.ruled_out | others)
        return problem, as_simulated(problem, look(problem))

    return pose


def fitted(problem: Problem, some: Members) -> Fit:
    """A set fitted where it begins, by slopes from signatures alone."""
    return joint(problem, some, problem.score.loss(problem.nominal), widths=())


def signatures_of(own, settings):
    """The signatures of a library, by simulation of all its episodes where they are seen on the recordings."""

    def simulated(some):
        return [residual(own.recs, own.plan, r) for r in replay_all(own.replayer, own.recs, own.begin, some)]

    return own.signatures(settings, simulated)
