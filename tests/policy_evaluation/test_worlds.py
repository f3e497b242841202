"""Worlds: what comes of a policy in simulated and in learned ones, and the policies that fail there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from candata.errors import DataError, UsageError
from candata.loaders import windows
from candata.policies import Goal, StepPolicy
from candata.policy_evaluation import pilots
from candata.policy_evaluation.learned import LearnedWorld
from candata.policy_evaluation.policies import EvaluatedPolicy, GivenCommands, read_policies
from candata.policy_evaluation.simulated import SimulatedWorld
from candata.policy_evaluation.starts import real_starts
from candata.schema.effect import EffectSetting
from candata.training.forecasters import ForecastArrays
from candata.training.servo_lag import fit_servo_lags

DURATION_S = 1.6
SLIPPERY = EffectSetting(name="sliding_friction", parameters={"scale": 0.3})


@dataclass(frozen=True)
class Lifts:
    """Forecasts that the object rises at a speed [m/s] while the hand is commanded beyond its lowest commands."""

    lowest: np.ndarray
    speed_m_s: float
    contact: float | None = 1.0
    summary: str = "a lift by hand"
    samples: int = 1
    simulator: None = None

    def forecast(self, batch, seed):
        moved = np.abs(batch["planned/action"] - self.lowest).max(-1) > 1e-3
        steps = np.zeros((1, *moved.shape, 6))
        steps[0, ..., 2] = 0.1 * self.speed_m_s * moved
        contact = None if self.contact is None else np.where(moved, self.contact, 0.0)
        return ForecastArrays(steps, contact)


@pytest.fixture(scope="module")
def read(recorded):
    """The recordings as a model reads them."""
    return windows(
        recorded,
        history=3,
        horizon=4,
        rate_hz=10.0,
        pad="both",
        channels=("object_pose", "joint_position", "action", "contact"),
    )


@pytest.fixture
def learned(gripper, read):
    """Makes a learned world of a forecast: `learned(speed_m_s, contact)`."""
    lowest = gripper.model.actuator_ctrlrange[gripper.actuator_ids, 0]

    def make(speed_m_s: float, contact: float | None = 1.0) -> LearnedWorld:
        forecaster: Any = Lifts(lowest, speed_m_s, contact)
        return LearnedWorld("model", gripper, forecaster, read, fit_servo_lags(read), 4)

    return make


def closed(begin, goal: Goal | None = None) -> EvaluatedPolicy:
    """A closed loop of a function `(scene, rng) -> step`."""
    from candata.policies import opening_plan

    return EvaluatedPolicy("acts", "here", opening_plan, StepPolicy("acts", "", begin), goal or Goal(lift_m=0.02))


def test_a_grasp_lifts_in_the_nominal_world_and_slips_in_a_slippery_one(gripper, starts, policies):
    (grasp,) = read_policies(policies({"name": "g", "source": "grasp_lift_shake"}), gripper)
    nominal = SimulatedWorld("nominal", gripper).play(grasp, starts, 1, DURATION_S)
    slippery = SimulatedWorld("slippery", gripper, (SLIPPERY,)).play(grasp, starts, 1, DURATION_S)
    assert nominal.success.all()
    assert not slippery.success.any()
    assert not nominal.failed.any()
    assert nominal.contact.max() == 1
    at = gripper.object_qpos
    np.testing.assert_allclose(nominal.object_pose[:, 0, :2], starts.qpos[:, at : at + 2], atol=2e-3)
    alone = SimulatedWorld("nominal", gripper).play(grasp, starts.take([1]), 1, DURATION_S)
    np.testing.assert_array_equal(alone.object_pose[0], nominal.object_pose[1])


def test_starts_are_those_of_the_recordings(gripper, recorded):
    found, notes = real_starts(gripper, recorded, recorded.ids[4:6], 5)
    assert found.ids == tuple(recorded.ids[4:6])
    assert notes == ()
    at = gripper.object_qpos
    poses = [recorded.episode(name)["object_pose"][:5, :3].mean(0) for name in found.ids]
    np.testing.assert_allclose(found.qpos[:, at : at + 3], poses, atol=2e-3)


def test_a_learned_world_moves_the_object_as_forecast_and_joints_by_their_lag(gripper, starts, learned):
    low, high = gripper.model.actuator_ctrlrange[gripper.actuator_ids].T
    rows = round(DURATION_S * gripper.file.rate_hz)
    commands = np.repeat((0.5 * (low + high))[None, None], len(starts), axis=0).repeat(rows, axis=1)
    commands[:, : rows // 4] = low
    policy = GivenCommands("close", commands, Goal(lift_m=0.02), settle_s=0.2)
    lifted = learned(0.1).play(policy, starts, 1, DURATION_S)
    assert lifted.outcomes == ("success",) * len(starts)
    rise = lifted.object_pose[:, -1, 2] - lifted.object_pose[:, 0, 2]
    np.testing.assert_allclose(rise, 0.1 * 0.75 * DURATION_S, atol=0.02)
    assert np.abs(lifted.joint_position[:, -1] - lifted.joint_position[:, 0]).max() > 0.001
    still = learned(0.0).play(policy, starts, 1, DURATION_S)
    assert set(still.outcomes) == {"slip"}  # the forecast contact holds it, and it does not rise
    untouched = learned(0.0, contact=0.0).play(policy, starts, 1, DURATION_S)
    assert set(untouched.outcomes) == {"miss"}
    assert "joints by a servo lag" in learned(0.1).summary


@pytest.mark.parametrize("goal", [Goal(turn_rad=0.1), Goal(lift_m=0.02, slip=True)], ids=["turn", "slip"])
def test_a_goal_that_contact_tells_is_refused_where_none_is_forecast(goal, starts, learned):
    middle = np.zeros((len(starts), 10, len(learned(0.0).windows.actuator_names)))
    policy = GivenCommands("still", middle, goal)
    with pytest.raises(UsageError, match="forecasts no contact"):
        learned(0.0, contact=None).play(policy, starts, 1, 0.2)
    assert learned(0.0).play(policy, starts, 1, 0.2).outcomes  # with contact it is told


def test_joints_of_planned_commands_may_be_those_of_the_nominal_simulator(gripper, starts, policies, learned):
    (grasp,) = read_policies(policies({"name": "g", "source": "grasp_lift_shake"}), gripper)
    simulated = SimulatedWorld("nominal", gripper).play(grasp, starts, 1, 0.5)
    world = replace(learned(0.1), joints="simulator")
    np.testing.assert_allclose(world.play(grasp, starts, 1, 0.5).joint_position, simulated.joint_position, atol=1e-6)
    assert "nominal simulator" in world.summary
    assert np.abs(learned(0.1).play(grasp, starts, 1, 0.5).joint_position - simulated.joint_position).max() > 1e-4


def test_a_policy_sees_the_forecast_of_pose_and_contact(gripper, starts, learned):
    seen: list[tuple[float, float]] = []

    def begin(scene, rng):
        low, high = scene.model.actuator_ctrlrange[scene.actuator_ids].T

        def step(observation):
            seen.append((float(observation.readings["object_pose"][2]), float(observation.readings["contact"])))
            return low + 0.5 * min(1.0, observation.time_s) * (high - low)

        return step

    played = learned(0.1).play(closed(begin), starts.take([0]), 1, 1.0)
    assert seen[-1][0] > seen[0][0] + 0.03
    assert (seen[0][1], seen[-1][1]) == (0.0, 1.0)
    assert played.commands[0, -1].max() > played.commands[0, 0].max()


def test_the_command_of_a_policy_acts_in_the_step_of_a_model_that_it_begins(gripper, starts, learned):
    low, high = gripper.model.actuator_ctrlrange[gripper.actuator_ids].T
    world = learned(0.1)

    def begin(scene, rng):
        return lambda observation: low if observation.time_s < 0.095 else high

    height = world.play(closed(begin), starts.take([0]), 1, 0.3).object_pose[0, :, 2]
    stride = round(gripper.file.rate_hz / world.windows.rate_hz)
    # It lies still for a step, and rises by a hundredth in the one that the other command begins.
    assert height[[stride, 2 * stride]] - height[0] == pytest.approx([0.0, 0.01], abs=1e-6)


@pytest.mark.parametrize("model", ["contact_diffusion", "sim_residual"])
def test_what_a_learned_world_draws_for_a_start_does_not_depend_on_the_others(model, gripper, starts, read, policies):
    torch = pytest.importorskip("torch")
    from candata.models import Sizes
    from candata.models import model as find_model
    from candata.testing.models import tiny_config
    from candata.training.forecasters import TrainedModel
    from candata.training.simulator import simulator

    kind = find_model(model)
    fields = {"cloud": "none", "latent": 16, "temporal_width": 8, "widths": (8, 16), "groups": 8}
    module = kind.build(tiny_config(kind, **fields), Sizes(**read.sizes()), read.normaliser).eval()
    draws = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for value in module.parameters():
            if not value.any():  # the last layer, which begins at zero
                value.copy_(0.5 * torch.randn(value.shape, generator=draws))
    source = simulator(read, None) if kind.needs_simulator else None
    forecaster = TrainedModel(module, torch.zeros(1, 1, 3), 2, 2, simulator=source)
    world = LearnedWorld("model", gripper, forecaster, read, fit_servo_lags(read), 4)
    (grasp,) = read_policies(policies({"name": "g", "source": "grasp_lift_shake"}), gripper)
    together, alone = (world.play(grasp, each, 1, 0.5) for each in (starts, starts.take([1])))
    np.testing.assert_allclose(alone.object_pose[0], together.object_pose[1], atol=1e-4)  # rounding grows in contact
    assert together.spread_m is not None
    assert together.spread_m.min() > 2e-4  # what is drawn matters


def test_a_channel_that_a_world_lacks_is_named(starts, learned):
    policy = closed(lambda scene, rng: lambda observation: observation.readings["fingertip_force"][0])
    with pytest.raises(DataError, match="reads a channel that the world model lacks") as error:
        learned(0.0).play(policy, starts.take([0]), 1, 0.3)
    assert "fingertip_force" in str(error.value)
    blind = closed(lambda scene, rng: lambda observation: observation.action * observation.readings["contact"])
    with pytest.raises(DataError, match="lacks"):
        learned(0.0, contact=None).play(blind, starts.take([0]), 1, 0.3)


@pytest.mark.parametrize(
    ("begin", "words"),
    [
        (lambda scene, rng: lambda observation: observation.action * np.nan, "not finite, at row 0"),
        (lambda scene, rng: lambda observation: observation.action[:-1], "shape"),
        (lambda scene, rng: 3, "not callable"),
        (lambda scene, rng: lambda observation: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_a_policy_that_gives_no_commands_is_one_error_that_names_it(begin, words, gripper, starts):
    with pytest.raises(DataError, match=words) as error:
        SimulatedWorld("nominal", gripper).play(closed(begin), starts.take([0]), 1, 0.3)
    assert "nominal" in str(error.value)


def test_a_policy_that_hangs_is_stopped(gripper, starts, monkeypatch):
    monkeypatch.setattr(pilots, "STEP_LIMIT_S", 0.05)

    def hang(observation):
        while True:
            pass

    with pytest.raises(DataError, match=r"no answer within 0.05 s"):
        SimulatedWorld("nominal", gripper).play(closed(lambda scene, rng: hang), starts.take([0]), 1, 0.3)


def test_a_model_that_reads_what_no_forecast_gives_is_no_world(gripper, read, learned):
    world = learned(0.0)
    shapes = {**read.cache.file.shapes, "fingertip_contact": (2,)}
    other = replace(read, cache=replace(read.cache, file=read.cache.file.model_copy(update={"shapes": shapes})))
    with pytest.raises(UsageError, match="cannot be a world"):
        replace(world, windows=other)
    renamed = read.cache.file.model_copy(update={"joint_names": ("a", "b")})
    with pytest.raises(UsageError, match="another hand"):
        replace(world, windows=replace(read, cache=replace(read.cache, file=renamed)))
