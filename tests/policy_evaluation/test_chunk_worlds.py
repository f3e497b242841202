"""Chunks in simulators and trained models, from the starts of recorded episodes; and networks distilled from chunks."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from candata.datasets import open_dataset
from candata.errors import DataError, UsageError
from candata.loaders import windows
from candata.policies import Goal, Observation, read_motions, read_step_policy
from candata.policies._network import Network
from candata.policy_evaluation.candidates import AS_PLANNED, Candidates, noisy_candidates, policy_chunks
from candata.policy_evaluation.chunk_bench import ChunkRequest, chunk_bench
from candata.policy_evaluation.chunk_starts import ChunkStarts, chunk_starts
from candata.policy_evaluation.chunk_worlds import FAMILIAR_SDS, ChunkWorld, simulated_world
from candata.policy_evaluation.commands import command_bounds
from candata.policy_evaluation.distillation import (
    chunk_rows,
    distilled_last_layer,
    distilled_network,
    write_network,
)
from candata.policy_evaluation.filtering import choose_chunks, withheld_result
from candata.policy_evaluation.goals import parsed_goal
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.schema.policy_card import PolicyCard
from candata.simulate.generate import generate
from candata.training.forecasters import Stays
from candata.training.runs import read_run, read_splits
from tests.cli.command import run

CHANNELS = ("object_pose", "joint_position", "action", "contact")
ROWS = 80
SLIPPERY = (EffectSetting(name="sliding_friction", parameters={"scale": 0.3}),)
#: A net of a few hundred weights: what is tested is the way, not the forecast.
CONFIG = "{width: 8, layers: 1}"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """Grasps by a gripper, without sensor noise."""
    folder = tmp_path_factory.mktemp("chunks") / "data"
    generate(folder, "gripper_tabletop", 10, 5, workers=1, noise=False, policies=("grasp_lift_shake",))
    return folder


@pytest.fixture(scope="module")
def scene():
    return load_scene("gripper_tabletop")


@pytest.fixture(scope="module")
def feed(data):
    return windows(data, channels=CHANNELS, pad="both")


@pytest.fixture(scope="module")
def starts(feed):
    return chunk_starts(feed, 4)


@pytest.fixture(scope="module")
def nominal(starts) -> ChunkWorld:
    return simulated_world("nominal", starts, ROWS, None, ())


def test_the_recorded_commands_are_forecast_as_they_went(starts, nominal, data, scene):
    forecast = nominal.forecast(starts.recorded(ROWS)[:, None], (0,))
    present = starts.windows.present_row[0] - starts.windows.cache.begin[starts.windows.owner[0]]
    recorded = next(iter(open_dataset(data).episodes())).arrays["object_pose"][present : present + ROWS + 1]
    assert np.ptp(recorded[:, 2]) > 0.02  # else staying would do
    assert np.abs(forecast.poses[0, 0, 0, :, :3] - recorded[:, :3]).max() < 0.01
    assert forecast.succeeds(parsed_goal("lift"), scene).all()
    assert forecast.cost(parsed_goal("lift")).reached.all()


def test_other_commands_and_other_worlds_end_otherwise(starts, nominal, scene):
    recorded = starts.recorded(ROWS)
    still = np.repeat(starts.previous[:, None], ROWS, axis=1)
    commands, goal = np.stack([recorded, still], axis=1), parsed_goal("lift")
    assert nominal.forecast(commands, (0,)).succeeds(goal, scene).tolist() == [[True, False]] * len(starts)
    slippery = simulated_world("slippery", starts, ROWS, None, SLIPPERY)
    assert not slippery.forecast(commands, (0,)).succeeds(goal, scene).any()


def test_a_start_reads_nothing_of_the_recording_behind_it(starts):
    """The present command belongs to the plan, and so does all that follows."""
    commands = np.zeros((len(starts), 1, ROWS, 8))
    batch = starts.batch(commands)
    assert not batch["planned/action"].any()
    assert not batch["history/action"][:, -1].any()
    assert batch["history/action"][:, -2].any()
    assert not batch["future_pad"].any()


def test_a_chooser_that_knows_the_world_gains_on_random_choice(starts, nominal, scene):
    recorded, goal = starts.recorded(ROWS), parsed_goal("lift")
    still = np.repeat(starts.previous[:, None], ROWS, axis=1)
    commands = np.stack([still, still, still, recorded], axis=1)
    candidates = Candidates((AS_PLANNED, "1", "2", "3"), commands, np.ones(commands.shape[:2], bool))
    choosers = [choose_chunks(nominal, commands, candidates.playable, goal, 0)]
    result = withheld_result(choosers, candidates, goal, scene, nominal, 0)
    assert result.planned.value == 0 < result.random.value < 0.6
    assert result.choosers["nominal"].after.value == 1
    assert result.choosers["nominal"].lift.low > 0.3
    assert result.choosers["nominal"].abstained.value == 0
    assert result.success["nominal"] == (True,) * len(starts)


def test_what_is_drawn_for_a_start_depends_on_no_other_start_or_chunk(feed, starts, scene):
    torch = pytest.importorskip("torch")
    from candata.models import Sizes, model
    from candata.testing.models import tiny_config
    from candata.training.forecasters import TrainedModel

    kind = model("contact_diffusion")
    fields = {"cloud": "none", "latent": 16, "temporal_width": 8, "widths": (8, 16), "groups": 8}
    module = kind.build(tiny_config(kind, **fields), Sizes(**feed.sizes()), feed.normaliser).eval()
    draws = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for value in module.parameters():
            if not value.any():  # the last layer, which begins at zero
                value.copy_(0.5 * torch.randn(value.shape, generator=draws))
    forecaster, bounds = TrainedModel(module, torch.zeros(1, 1, 3), 2, 2), command_bounds(scene, feed)
    second = ChunkStarts(
        replace(starts.windows, present_row=starts.windows.present_row[1:2], owner=starts.windows.owner[1:2])
    )
    together, alone = (
        noisy_candidates(each.recorded(ROWS), each, bounds, count, 0.3, 0).commands
        for each, count in ((starts, 3), (second, 2))
    )
    assert np.array_equal(together[1, 1], alone[0, 1])
    poses, same = (
        ChunkWorld("m", forecaster, each, feed.normaliser).forecast(commands, (0,)).poses
        for each, commands in ((starts, together), (second, alone))
    )
    assert np.allclose(poses[:, 1, :2], same[:, 0], rtol=0, atol=1e-5)  # sums of float32 in another order
    assert np.abs(poses[0] - poses[1]).max() > 1e-3  # what is drawn matters


def test_a_chunk_beyond_the_horizon_is_refused(nominal, starts):
    with pytest.raises(UsageError, match="longer than nominal can roll"):
        nominal.forecast(starts.recorded(ROWS + 1)[:, None], (0,))


def test_starts_need_a_whole_history(feed):
    with pytest.raises(UsageError, match="before the first whole history"):
        chunk_starts(feed, 4, at_s=0.2)
    with pytest.raises(DataError, match="no episode has a start"):
        chunk_starts(feed, 4, at_s=60.0)


def test_commands_far_from_the_training_rows_are_strange_and_those_of_the_recording_are_not(feed, starts):
    normaliser = feed.normaliser
    world = ChunkWorld("stays", Stays(), starts, normaliser)
    recorded = starts.recorded(ROWS)
    _, scale = normaliser.channel("action")
    far = recorded + np.r_[2 * FAMILIAR_SDS * scale[:1], np.zeros(7)]
    assert world.is_familiar(np.stack([recorded, far], axis=1)).tolist() == [[True, False]] * len(starts)


def rows_of(starts, nominal, commands):
    return chunk_rows(nominal.starts, commands, nominal.forecaster)


def test_bounds_are_those_of_the_recordings(feed, scene, data):
    bounds = command_bounds(scene, feed)
    steps = [np.abs(np.diff(e.arrays["action"], axis=0)).max(0) for e in open_dataset(data).episodes()]
    assert np.allclose(bounds.step, np.max(steps, axis=0), rtol=1e-5)


def test_a_jump_over_missing_rows_is_no_step_that_may_be_played(feed, scene):
    cache, bounds = feed.cache, command_bounds(scene, feed)
    rows, stretch, valid = cache.rows.copy(), cache.stretch.copy(), cache.valid.copy()
    rows["action"][cache.begin[0] + 5 : cache.end[0]] += 1.0
    stretch[cache.begin[0] + 5 : cache.end[0]] += 1
    broken = replace(feed, cache=replace(cache, rows=rows, stretch=stretch))
    assert np.allclose(command_bounds(scene, broken).step, bounds.step, atol=1e-5)
    valid[cache.begin[0] + 5] = False
    unknown = replace(feed, cache=replace(cache, rows=rows, valid=valid))
    assert np.allclose(command_bounds(scene, unknown).step, bounds.step, atol=1e-5)


def test_rows_of_chunks_are_recorded_up_to_the_start_and_simulated_behind(starts, nominal, data):
    rows = rows_of(starts, nominal, starts.recorded(ROWS))
    recorded = next(iter(open_dataset(data).episodes())).arrays
    count = len(rows.commands[0])
    assert np.allclose(rows.commands[0], recorded["action"][:count], atol=1e-6)
    assert np.allclose(rows.readings[0]["joint_position"], recorded["joint_position"][:count], atol=0.02)
    assert np.array_equal(rows.readings[0]["action"][1:], rows.commands[0][:-1])


def network(scene, rng) -> Network:
    """A network of random weights."""
    card = PolicyCard(inputs=("joint_position", "action"), history=2, activation="tanh", scene_digest=scene.digest)
    sizes = (2 * (len(scene.joint_qpos) + 8), 24, 8)
    layers = tuple((rng.normal(0, 0.3, (b, a)), np.zeros(b)) for a, b in itertools.pairwise(sizes))
    return Network(card, layers, 0.0, 1.0, 0.0, 1.0, Path())


def commanded(policy: Network, scene, rows) -> np.ndarray:
    """What a network commands `(T, 8)` when it sees the rows of the first chunk."""
    step, readings = policy.begin(scene), rows.readings[0]
    return np.array(
        [
            step(Observation(k, 0.0, {name: values[k] for name, values in readings.items()}, readings["action"][k]))
            for k in range(len(rows.commands[0]))
        ]
    )


def test_a_last_layer_fitted_anew_commands_the_chunks_and_leaves_the_others_alone(starts, nominal, scene, rng):
    before, rows = network(scene, rng), rows_of(starts, nominal, starts.recorded(ROWS))
    after = distilled_last_layer(before, rows)
    error = [np.abs(commanded(each, scene, rows) - rows.commands[0]).mean() for each in (before, after)]
    assert error[1] < 0.3 * error[0]
    assert np.array_equal(before.layers[0][0], after.layers[0][0])


def test_a_network_from_nothing_commands_the_chunks_and_plays_from_its_file(starts, nominal, scene, tmp_path):
    rows = rows_of(starts, nominal, starts.recorded(ROWS))
    path = write_network(tmp_path / "made.safetensors", distilled_network(rows, scene, 0, steps=300))
    policy = read_step_policy(str(path))
    step = policy.begin(scene, np.random.default_rng(0))
    change, still = [], []
    for k in range(len(rows.commands[0])):
        seen = {name: values[k] for name, values in rows.readings[0].items()}
        given = step(Observation(k, 0.0, seen, seen["action"]))
        change.append(given - rows.commands[0][k])
        still.append(seen["action"] - rows.commands[0][k])
    assert np.square(change).mean() < 0.6 * np.square(still).mean()  # a third of the change is noise of the commands


def test_a_policy_that_reads_forces_is_not_distilled(starts, nominal, scene, rng):
    policy = network(scene, rng)
    policy = replace(policy, card=policy.card.model_copy(update={"inputs": ("fingertip_force",)}))
    with pytest.raises(UsageError, match="reads what refined chunks do not hold"):
        distilled_last_layer(policy, rows_of(starts, nominal, starts.recorded(ROWS)))


def test_a_closed_loop_plans_what_it_commands_from_the_start_on(starts, scene):
    policy = SimpleNamespace(name="p", begin=lambda _scene, _rng: lambda seen: seen.action + 0.001)
    chunks = policy_chunks(policy, scene, starts, 5, 0)
    assert np.allclose(chunks, starts.previous[:, None] + 0.001 * np.arange(1, 6)[:, None], atol=1e-9)


def test_a_closed_loop_that_commands_no_number_is_refused(starts, scene):
    policy = SimpleNamespace(name="p", begin=lambda _scene, _rng: lambda seen: np.nan * seen.action)
    with pytest.raises(DataError, match="gave no commands"):
        policy_chunks(policy, scene, starts, 5, 0)


def test_a_closed_loop_sees_contact_and_is_told_what_the_simulation_lacks(starts, scene):
    seen_contacts = []

    def reads(name):
        def step(seen):
            seen_contacts.append(float(seen.readings[name]))
            return seen.action

        return SimpleNamespace(name="p", begin=lambda _scene, _rng: step)

    policy_chunks(reads("contact"), scene, starts, 5, 0)
    assert set(seen_contacts) <= {0.0, 1.0}
    assert len(seen_contacts) == 5 * len(starts)
    with pytest.raises(DataError, match="reads a channel that the world simulation lacks"):
        policy_chunks(reads("hand_pose"), scene, starts, 5, 0)


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "run"
    assert train(data, folder).code == 0
    return folder


def train(data: Path, folder: Path, config: str = CONFIG) -> SimpleNamespace:
    (folder.parent / "config.yaml").write_text(config)
    words = ("--model", "mlp", "--config", folder.parent / "config.yaml", "--steps", 4, "--batch", 8, "--threads", 1)
    return run("train", "--data", data, "--out", folder, *words)


def test_filter_prints_who_gained_what_and_writes_playable_chunks(trained, data, scene, tmp_path):
    effects, out = tmp_path / "slippery.yaml", tmp_path / "chosen.parquet"
    setting = {"name": "sliding_friction", "parameters": {"scale": 0.3}}
    effects.write_text(yaml.safe_dump({"scene": "gripper_tabletop", "effects": [setting]}))
    words = ("policy", "filter", trained, data, "--candidates", 3, "--samples", 1, "--chunk", 0.5, "--threads", 1)
    made = run(*words, "--withheld", effects, "--effects", effects, "--out", out, "--json")
    assert made.code == 0, made.err
    result = json.loads(made.out)
    assert set(result["withheld"]["choosers"]) == {"run", "nominal simulator", "repaired simulator"}
    chosen = [start["candidate"] for start in result["starts"]]
    assert len(read_motions(out, scene).motions) == sum(name is not None for name in chosen) > 0
    again = run(*words[:4], "--policy", out, *words[4:])
    if sum(name is not None for name in chosen) < 2:
        assert "nothing to choose between" in again.err
    else:
        assert "abstained" in again.out


def test_refine_writes_a_policy_that_generate_sim_plays(trained, data, scene, rng, tmp_path):
    out, played = tmp_path / "refined.safetensors", tmp_path / "played"
    policy = write_network(tmp_path / "policy.safetensors", network(scene, rng))
    words = ("--candidates", 3, "--rounds", 1, "--samples", 1, "--chunk", 0.5, "--threads", 1, "--out", out)
    made = run("policy", "refine", trained, data, "--policy", policy, *words)
    assert made.code == 0, made.err
    assert "refined the chunk of 0.5 s" in made.out
    sim = ("--scene", "gripper_tabletop", "--episodes", 1, "--duration-s", 0.4, "--jobs", 1, "--out", played)
    assert run("generate-sim", "--policy-module", out, *sim).code == 0


def test_a_chunk_longer_than_the_model_can_roll_is_refused(trained, data):
    refused = run("policy", "filter", trained, data, "--chunk", 2.0)
    assert refused.code == 2
    assert "longer than run can roll" in refused.err
    assert "at most 1.6 s" in refused.err


@pytest.mark.parametrize(("option", "value", "words"), [("--chunk", "nan", "no time"), ("--at", "inf", "no time")])
def test_a_time_that_is_no_number_is_refused(option, value, words, trained, data):
    refused = run("policy", "filter", trained, data, option, value)
    assert refused.code == 2
    assert words in refused.err


def test_a_chunk_of_no_length_is_refused(trained, data):
    assert "a chunk is too short" in run("policy", "filter", trained, data, "--chunk", 0).err


def test_a_file_of_another_kind_is_refused_before_anything_is_computed(tmp_path):
    refused = run("policy", "refine", "no run", "no data", "--out", tmp_path / "policy.onnx")
    assert refused.code == 2
    assert "a .safetensors file" in refused.err


@pytest.mark.parametrize("command", ["filter", "refine"])
def test_a_repair_that_would_change_nothing_is_refused(command, tmp_path):
    refused = run("policy", command, "no run", "no data", "--effects", tmp_path / "effects.yaml")
    assert refused.code == 2
    assert "the repaired simulator has nothing to do" in refused.err


def test_a_model_that_does_not_read_the_plan_is_refused(data, tmp_path):
    folder = tmp_path / "blind"
    assert train(data, folder, "{width: 8, layers: 1, planned_actions: false}").code == 0
    with pytest.raises(UsageError, match="does not read the planned commands"):
        chunk_bench(folder, open_dataset(data), ChunkRequest(Goal(lift_m=0.02)))


def test_a_model_that_was_trained_on_the_test_starts_is_refused(trained, data, tmp_path):
    seen = read_splits(trained, read_run(trained))[0].train
    quoted = ", ".join(f"'{name}'" for name in seen)
    assert run("registry", "filter", data, f"id in ({quoted})", "--out", tmp_path / "seen").code == 0
    with pytest.raises(UsageError, match="was trained on episodes of the group test"):
        chunk_bench(trained, open_dataset(tmp_path / "seen"), ChunkRequest(Goal(lift_m=0.02)))


def test_a_model_of_another_hand_is_refused(trained, tmp_path):
    other = tmp_path / "other"
    generate(other, "xhand_tabletop", 10, 9, workers=1, noise=False, duration_s=2.4, policies=("free_sweep",))
    with pytest.raises(UsageError, match="joint"):
        chunk_bench(trained, open_dataset(other), ChunkRequest(Goal(lift_m=0.02)))
