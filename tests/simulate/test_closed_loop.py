"""Policies that answer step by step: they see what is stored, and what they give is checked, stored and replayed."""

from __future__ import annotations

import json

import numpy as np
import pytest
from safetensors.numpy import save_file

from candata.datasets import open_dataset
from candata.errors import DataError, UsageError
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import closed_loop
from candata.simulate.generate import Withheld, generate
from candata.simulate.repetition import repeat_episode

SET = {"scene": "gripper_tabletop", "episodes": 3, "seed": 4, "duration_s": 0.4, "workers": 1}
MODULE = """
import numpy as np

seen = []

def watch(scene, rng):
    share = rng.uniform(0.2, 0.8)
    target = scene.model.actuator_ctrlrange[scene.actuator_ids]
    def step(observation):
        seen.append(observation)
        return target[:, 0] + share * (target[:, 1] - target[:, 0]) * min(1, 4 * observation.time_s)
    return step

def not_finite(scene, rng):
    return lambda observation: observation.action * (np.nan if observation.row == 5 else 1)

def too_short(scene, rng):
    return lambda observation: observation.action[:1]

def fails(scene, rng):
    return lambda observation: {}["nothing"]

def hangs(scene, rng):
    def step(observation):
        while True:
            pass
    return step

def no_step(scene, rng):
    return 3

def beyond(scene, rng):
    return lambda observation: observation.action + 1e6
"""


@pytest.fixture
def module(tmp_path) -> str:
    path = tmp_path / "grip.py"
    path.write_text(MODULE)
    return str(path)


def test_a_policy_sees_what_the_episode_stores_and_its_commands_are_played(tmp_path, module):
    generate(tmp_path / "set", **SET, step_policy=f"{module}:watch")
    episodes = list(open_dataset(tmp_path / "set"))
    assert {e.meta.task for e in episodes} == {"watch"}
    assert len({float(e["action"][-1, 0]) for e in episodes}) == 3, "each episode has a generator of its own"
    from candata.policies import read_step_policy
    from candata.simulate.episodes import EpisodeJob, make_episodes

    scene, observations = load_scene("gripper_tabletop"), []
    policy = read_step_policy(f"{module}:watch")

    def begin(scene, rng):
        step = policy.begin(scene, rng)
        return lambda observation: (observations.append(observation), step(observation))[1]

    job = EpisodeJob("e", 0, "watch", 4, step_policy=type(policy)("watch", "", begin))
    (episode,) = make_episodes(scene, [job], duration_s=0.4, noise=scene.file.noise)
    assert len(observations) == len(episode)
    for name in ("object_pose", "joint_position", "fingertip_force"):
        np.testing.assert_allclose([o.readings[name] for o in observations], episode[name], atol=1e-6)
    np.testing.assert_allclose([o.action for o in observations[1:]], episode["action"][:-1], atol=1e-6)
    assert np.ptp(episode["joint_position"][:, 0]) > 1e-3, "the hand follows"
    np.testing.assert_array_equal(episode["action"], episodes[0]["action"])


def test_workers_change_nothing_and_an_episode_is_made_again(tmp_path, module):
    first = generate(tmp_path / "a", **{**SET, "episodes": 18}, step_policy=f"{module}:watch")
    second = generate(tmp_path / "b", **{**SET, "episodes": 18, "workers": 2}, step_policy=f"{module}:watch")
    assert first.digest == second.digest
    dataset = open_dataset(tmp_path / "a")
    name = "gripper_tabletop-s4-000017"
    with pytest.raises(UsageError, match="closed loop"):
        repeat_episode(dataset, name)
    assert repeat_episode(dataset, name, step_policy=f"{module}:watch").meta.id == name
    (tmp_path / "grip.py").write_text(MODULE + "\n")
    with pytest.raises(DataError, match="not the one"):
        repeat_episode(dataset, name, step_policy=f"{module}:watch")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("not_finite", "some that are not finite, at row 5"),
        ("too_short", r"shape \(1,\), at row 0"),
        ("fails", "KeyError"),
        ("no_step", "does not begin"),
        ("nosuch", "has no function nosuch"),
    ],
)
def test_what_gives_no_commands_is_one_error(tmp_path, module, name, said):
    with pytest.raises((DataError, UsageError), match=said):
        generate(tmp_path / "set", **SET, step_policy=f"{module}:{name}")


def test_a_policy_that_hangs_is_stopped(tmp_path, module, monkeypatch):
    monkeypatch.setattr(closed_loop, "STEP_LIMIT_S", 0.2)
    with pytest.raises(DataError, match="no answer within"):
        generate(tmp_path / "set", **SET, step_policy=f"{module}:hangs")


def test_commands_are_kept_within_the_limits(tmp_path, module):
    generate(tmp_path / "set", **{**SET, "episodes": 1}, step_policy=f"{module}:beyond")
    scene = load_scene("gripper_tabletop")
    (episode,) = open_dataset(tmp_path / "set")
    high = scene.model.actuator_ctrlrange[scene.actuator_ids][:, 1]
    assert (episode["action"] <= high + 1e-6).all()
    assert (episode["action"][1:] > high - 0.1).any()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"step_policy": "nothing"}, "names no policy"),
        ({"step_policy": "no.such.module:f"}, "no module"),
        ({"step_policy": "missing.py:f"}, "does not exist"),
        ({"step_policy": "missing.safetensors"}, "does not exist"),
    ],
)
def test_a_source_that_is_none_is_a_usage_error(tmp_path, words, said):
    with pytest.raises(UsageError, match=said):
        generate(tmp_path / "set", **SET, **words)


def test_policies_beside_a_closed_loop_and_a_drifting_clock_are_refused(tmp_path, module):
    loop = {"step_policy": f"{module}:watch"}
    with pytest.raises(UsageError, match="two sources"):
        generate(tmp_path / "set", **SET, **loop, policies=["squeeze"])
    with pytest.raises(UsageError, match="clock"):
        generate(tmp_path / "set", **SET, **loop, effects=[EffectSetting(name="clock_drift")])


def write_network(path, card=None, **changes):
    """A network that gives tanh of the joints' readings, weighed, as a change of the commands."""
    scene = load_scene("gripper_tabletop")
    joints, commands = len(scene.joint_qpos), len(scene.actuator_ids)
    tensors = {
        "layers.0.weight": np.eye(4, 2 * joints, dtype=np.float32),
        "layers.0.bias": np.zeros(4, np.float32),
        "layers.1.weight": np.full((commands, 4), 1e-3, np.float32),
        "layers.1.bias": np.full(commands, 1e-3, np.float32),
        **changes,
    }
    save_file({name: value for name, value in tensors.items() if value is not None}, path)
    full = {"inputs": ["joint_position"], "history": 2, "activation": "tanh", "commands": "change", **(card or {})}
    path.with_suffix(".json").write_text(json.dumps(full))
    return str(path)


def test_a_network_gives_the_commands_that_its_card_says(tmp_path):
    source = write_network(tmp_path / "net.safetensors", {"scene_digest": load_scene("gripper_tabletop").digest})
    generate(tmp_path / "set", **SET, step_policy=source)
    (episode, *_) = open_dataset(tmp_path / "set")
    joints = np.asarray(episode["joint_position"], float)
    both = np.concatenate([np.concatenate([joints[:1], joints[:-1]]), joints], axis=1)[:, :4]
    change = 1e-3 * np.tanh(both).sum(1) + 1e-3
    np.testing.assert_allclose(np.diff(episode["action"][:, 0]), change[1:], atol=1e-5)


@pytest.mark.parametrize(
    ("card", "changes", "said"),
    [
        ({"scene_digest": "0" * 64}, {}, "another scene"),
        ({"history": 3}, {}, "does not fit"),
        ({"inputs": []}, {}, "inputs"),
        ({"activation": "gelu"}, {}, "activation"),
        ({}, {"layers.1.bias": None}, "holds no network"),
        ({}, {"layers.0.bias": np.zeros(5, np.float32)}, "layer 0"),
        ({}, {"layers.0.bias": np.full(4, np.nan, np.float32)}, "finite"),
        ({}, {"input_scale": np.zeros(4, np.float32)}, "input_scale"),
        ({}, {"other": np.zeros(4, np.float32)}, "holds no network"),
    ],
)
def test_a_network_that_does_not_fit_is_one_error(tmp_path, card, changes, said):
    source = write_network(tmp_path / "net.safetensors", card, **changes)
    with pytest.raises((DataError, UsageError), match=said):
        generate(tmp_path / "set", **SET, step_policy=source)


def test_a_damaged_network_is_one_error(tmp_path):
    source = write_network(tmp_path / "net.safetensors")
    (tmp_path / "net.safetensors").write_bytes(b"no tensors")
    with pytest.raises(DataError, match="cannot be read"):
        generate(tmp_path / "set", **SET, step_policy=source)


def test_an_episode_whose_policy_fails_is_left_out_and_the_others_are_as_ever(tmp_path):
    watch = "lambda observation: observation.action * 0.9 + 0.001"
    (tmp_path / "all.py").write_text(f"def policy(scene, rng):\n    return {watch}\n")
    (tmp_path / "some.py").write_text(
        "def policy(scene, rng):\n    bad = rng.uniform() < 0.5\n"
        f"    return lambda observation: None if bad and observation.row == 9 else ({watch})(observation)\n"
    )
    words = {**SET, "episodes": 8}
    generate(tmp_path / "all", **words, step_policy=str(tmp_path / "all.py:policy"))
    generate(tmp_path / "some", **words, step_policy=str(tmp_path / "some.py:policy"))
    complete, partly = open_dataset(tmp_path / "all"), list(open_dataset(tmp_path / "some"))
    assert 0 < len(partly) < 8
    for episode in partly:
        np.testing.assert_array_equal(episode["object_pose"], complete.episode(episode.meta.id)["object_pose"])


def test_a_policy_that_would_end_the_program_or_gives_complex_numbers_is_one_error(tmp_path):
    (tmp_path / "bad.py").write_text(
        "import sys\n"
        "def leaves(scene, rng):\n    return lambda observation: sys.exit(0)\n"
        "def complex_numbers(scene, rng):\n    return lambda observation: observation.action + 1j\n"
    )
    for name, said in (("leaves", "SystemExit"), ("complex_numbers", "complex numbers")):
        with pytest.raises(DataError, match=said):
            generate(tmp_path / "set", **SET, step_policy=f"{tmp_path / 'bad.py'}:{name}")


def test_a_withheld_effect_that_might_be_a_drifting_clock_is_refused_before_it_is_drawn(tmp_path, module):
    withheld = Withheld("any", tmp_path / "seal.json")
    with pytest.raises(UsageError, match="clock that drifts"):
        generate(tmp_path / "set", **SET, step_policy=f"{module}:watch", withheld=withheld)
    assert not (tmp_path / "seal.json").exists()
