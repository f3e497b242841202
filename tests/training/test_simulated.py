"""The simulator's forecasts of all windows that train, and the model that corrects them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
import torch

from candata.datasets import open_dataset
from candata.errors import UsageError
from candata.loaders import Augmentation, augment, mix, noise, windows
from candata.loaders.increments import increments
from candata.models import Sizes
from candata.models import model as find_model
from candata.scenes.contract import OBJECTS
from candata.schema.effect import EffectSetting
from candata.simulate.generate import generate
from candata.testing.models import tiny_config
from candata.training import TrainingSettings, TrainRequest, prepare, simulated, train
from candata.training.checkpoint import read
from candata.training.evaluation import EvaluationSettings, evaluate
from candata.training.forecasters import TrainedModel
from candata.training.rollout import close_loop, course
from candata.training.run_simulator import trained_simulator
from candata.training.simulated import simulated_windows, thinned
from candata.training.simulator import Simulator, simulator

CHANNELS = ("object_pose", "joint_position", "action")
LATE = (EffectSetting(name="actuation_delay", parameters={"delay_s": 0.08}),)
TINY = {"cloud": "none", "latent": 16, "temporal_width": 8, "widths": (8, 16), "groups": 8}


def few_windows(dataset, step=20):
    return windows(dataset, channels=CHANNELS, history=3, horizon=4, step=step)


@dataclass(frozen=True, eq=False)
class Counting(Simulator):
    """A simulator that counts the windows it simulates, and is stopped after some."""

    counts: list = None
    most: int = 10_000

    def simulate(self, batch):
        if sum(self.counts) >= self.most:
            raise KeyboardInterrupt
        self.counts.append(len(batch["row"]))
        return super().simulate(batch)


def counting(counts, most=10_000):
    """Returns what builds a counting simulator."""

    def build(feed):
        made = simulator(feed, None)
        return Counting(made.windows, made.scenes, made.summary, 1, counts, most)

    return build


def test_batches_hold_what_the_simulator_says(nominal, tmp_path):
    feed = few_windows(nominal)
    batch = simulated_windows(feed, partial(simulator, scene=None), folder=tmp_path).batch([3, 0, 2])
    said = simulator(feed, None).keys(feed.batch([3, 0, 2]))
    for name, values in said.items():
        assert batch[name].dtype == np.float32
        assert np.allclose(batch[name], values, atol=1e-6), name


def test_forecasts_are_made_once_and_for_each_world(nominal, tmp_path):
    feed, counts = few_windows(nominal), []
    first = simulated_windows(feed, counting(counts), folder=tmp_path)
    again = simulated_windows(feed, counting(counts), folder=tmp_path)
    assert sum(counts) == len(feed)
    assert np.array_equal(first.forecasts[0], again.forecasts[0])
    late = simulated_windows(feed, partial(simulator, scene=None, effects=LATE), folder=tmp_path)
    assert not np.allclose(late.forecasts[0], first.forecasts[0], atol=1e-4)


def test_a_stopped_run_goes_on_with_the_next_chunk(nominal, tmp_path, monkeypatch):
    monkeypatch.setattr(simulated, "CHUNK", 4)
    feed, counts, later_counts = few_windows(nominal), [], []
    with pytest.raises(KeyboardInterrupt):
        simulated_windows(feed, counting(counts, most=8), folder=tmp_path)
    resumed = simulated_windows(feed, counting(later_counts), folder=tmp_path)
    assert sum(counts) == 8
    assert sum(later_counts) == len(feed) - 8
    whole = simulated_windows(feed, partial(simulator, scene=None), folder=tmp_path / "whole")
    assert np.array_equal(resumed.forecasts[0], whole.forecasts[0])
    assert [path.suffix for path in tmp_path.iterdir() if path.name != "whole"] == [".npy"]  # no chunk is left


def test_a_damaged_file_is_made_again(nominal, tmp_path):
    feed, counts = few_windows(nominal), []
    first = np.array(simulated_windows(feed, counting(counts), folder=tmp_path).forecasts[0])
    (path,) = tmp_path.glob("*.npy")
    with path.open("r+b") as file:
        file.seek(-3, 2)
        file.write(b"\x55")
    again = simulated_windows(feed, counting(counts), folder=tmp_path)
    assert sum(counts) == 2 * len(feed)
    assert np.array_equal(again.forecasts[0], first)


def test_of_a_mixture_each_window_gets_its_own(nominal, tmp_path):
    parts = {"a": few_windows(nominal), "b": few_windows(nominal, step=30)}
    mixed = mix(parts, "a:0.5,b:0.5")
    batch = simulated_windows(mixed, partial(simulator, scene=None), folder=tmp_path).batch([1, len(parts["a"]) + 2])
    for place, (name, number) in enumerate((("a", 1), ("b", 2))):
        said = simulator(parts[name], None).keys(parts[name].batch([number]))["simulated/object_pose"]
        assert np.allclose(batch["simulated/object_pose"][place], said[0], atol=1e-6)


def test_where_poses_are_missing_no_window_begins_and_the_others_are_finite(nominal, tmp_path, rewritten):
    def gaps(episode):
        valid = np.random.default_rng(0).random(len(episode)) > 0.05
        pose = episode["object_pose"].copy()
        pose[~valid] = np.nan
        return {"object_pose": pose, "object_pose_valid": valid}

    feed = few_windows(rewritten(tmp_path / "data", nominal, gaps), step=3)
    assert feed.cache.valid[feed.present_row].all()
    assert len(feed) < len(few_windows(nominal, step=3))
    forecasts = simulated_windows(feed, partial(simulator, scene=None), folder=tmp_path).forecasts[0]
    assert np.isfinite(forecasts).all()
    truth = feed.batch(np.arange(len(feed)))
    error = np.linalg.norm(forecasts[..., :3] - truth["future/object_pose"][..., :3], axis=-1)[~truth["future_pad"]]
    assert error.mean() < 0.005


def test_long_data_are_thinned_to_one_window_a_model_step_at_most(nominal, monkeypatch):
    feed = few_windows(nominal, step=1)
    assert len(thinned(feed)) == len(feed)
    monkeypatch.setattr(simulated, "DENSE_WINDOWS", 10)
    rows = thinned(feed).present_row - feed.cache.begin[thinned(feed).owner]
    assert set(rows % int(feed.stride[0])) == {0}


def test_noise_on_poses_moves_what_is_simulated_along(nominal, tmp_path):
    batch = simulated_windows(few_windows(nominal), partial(simulator, scene=None), folder=tmp_path).batch([0, 1, 2])
    moved = augment(batch, Augmentation(position_m=0.1, rotation_rad=0.5), noise(0, 0))
    before, after = (
        increments(np.concatenate([each["history/object_pose"][:, -1:], each["simulated/object_pose"]], axis=1))
        for each in (batch, moved)
    )
    assert not np.allclose(moved["simulated/object_pose"], batch["simulated/object_pose"], atol=0.01)
    assert np.allclose(after, before, atol=1e-5)


def test_an_untrained_net_is_the_simulator(nominal):
    feed = few_windows(nominal)
    model, made = find_model("sim_residual"), simulator(feed, None, LATE)
    module = model.build(tiny_config(model, **TINY), Sizes(**feed.sizes()), feed.normaliser)
    batch, clouds = feed.batch(np.arange(len(feed))), torch.zeros(0, 0, 3)
    forecast = TrainedModel(module, clouds, 2, 1, simulator=made).forecast(batch, (0,))
    said = made.forecast(batch)
    assert np.allclose(forecast.increments, said.increments, atol=2e-6)
    assert np.array_equal(forecast.contact, said.contact)


def test_where_joints_are_simulated_no_recorded_ones_behind_the_beginning_of_a_loop_are_read(nominal):
    feed = few_windows(nominal)
    model = find_model("sim_residual")
    module = model.build(tiny_config(model, **TINY), Sizes(**feed.sizes()), feed.normaliser)

    def loop(source):
        seen, made = course(source), simulator(source, None)
        fed = replace(seen, joints=made.free_run(seen).joints)
        return close_loop(fed, TrainedModel(module, torch.zeros(0, 0, 3), 1, 1, simulator=made), 2, 0)

    rows = feed.cache.rows.copy()
    begins = course(feed)
    for episode, row in zip(begins.episodes, begins.windows.present_row, strict=True):
        rows["joint_position"][row + 1 : feed.cache.end[episode]] += 0.2
    other = replace(feed, cache=replace(feed.cache, rows=rows))
    assert np.array_equal(loop(feed).poses, loop(other).poses)


class TestTraining:
    """`candata train --model sim_residual`."""

    @pytest.fixture
    def data(self, nominal, tmp_path, rewritten, monkeypatch):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
        monkeypatch.setattr(simulated, "DENSE_WINDOWS", 60)
        return rewritten(tmp_path / "data", nominal, lambda _: {})

    def request(self, **options):
        return TrainRequest(model="sim_residual", config=TINY, history=3, horizon=4, **options)

    def settings(self):
        return TrainingSettings(steps=4, batch=8, validate_every=4)

    def test_a_run_knows_its_simulator(self, data, tmp_path):
        job = prepare(data, self.request(effects=LATE), self.settings())
        train(job, tmp_path / "run")
        checkpoint, feed = read(tmp_path / "run"), few_windows(data)
        assert checkpoint.run.simulator.effects == LATE
        made = trained_simulator(checkpoint, feed)
        batch = feed.batch([0, 1])
        assert np.array_equal(made.simulate(batch).object_pose, simulator(feed, None, LATE).simulate(batch).object_pose)

    def test_another_scene_than_it_was_trained_with_is_refused(self, data, tmp_path):
        train(prepare(data, self.request(), self.settings()), tmp_path / "run")
        checkpoint = read(tmp_path / "run")

        def trained_in(digests):
            facts = checkpoint.run.simulator.model_copy(update={"digests": digests})
            return replace(checkpoint, run=checkpoint.run.model_copy(update={"simulator": facts}))

        for name in (*checkpoint.run.simulator.digests, "elsewhere/scene.yaml"):
            with pytest.raises(UsageError, match="is not the one that the model was trained in"):
                trained_simulator(trained_in({name: "0" * 64}), few_windows(data))
        # Where its file lies decides nothing.
        (digest,) = checkpoint.run.simulator.digests.values()
        assert trained_simulator(trained_in({"elsewhere/scene.yaml": digest}), few_windows(data)) is not None

    def test_data_without_a_scene_are_refused_before_the_first_step(self, nominal, tmp_path, rewritten):
        data = rewritten(tmp_path / "data", nominal, lambda _: {}, scene=None)
        with pytest.raises(UsageError, match="name no scene"):
            prepare(data, self.request(), self.settings())

    def test_effects_for_a_model_that_reads_no_simulator_are_refused(self, data):
        with pytest.raises(UsageError, match="mlp reads no simulator"):
            prepare(data, TrainRequest(model="mlp", history=3, horizon=4, effects=LATE), self.settings())

    def test_an_object_that_a_run_has_not_met_is_said_and_a_changed_one_refused(self, tmp_path, monkeypatch):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
        monkeypatch.setattr(simulated, "DENSE_WINDOWS", 60)

        def put(folder, name, mass_kg):
            (folder / name).mkdir(parents=True)
            can = OBJECTS.load("can").file.model_copy(update={"name": name, "mass_kg": mass_kg})
            (folder / name / "object.yaml").write_text(can.model_dump_json())
            return str(folder / name)

        for name in ("empty", "full"):
            place = put(tmp_path / "objects", name, 0.1)
            played = {"workers": 1, "duration_s": 0.8, "objects": [place], "policies": ("push",)}
            generate(tmp_path / name, "gripper_tabletop", 3, 1, **played)
        scene = f"gripper_tabletop+{tmp_path / 'objects'}"
        train(prepare(open_dataset(tmp_path / "empty"), self.request(scene=scene), self.settings()), tmp_path / "run")

        def notes(name, **options):
            settings = EvaluationSettings(group="all", samples=1, steps=1, simulator=False, **options)
            return evaluate([tmp_path / "run"], open_dataset(tmp_path / name), settings)[0].notes

        assert notes("empty") == ()
        assert notes("full") == ("run was last trained without full",)
        put(tmp_path / "elsewhere", "empty", 0.2)
        with pytest.raises(UsageError, match="is not the one that the model was trained in"):
            trained_simulator(
                read(tmp_path / "run"), few_windows(tmp_path / "empty"), f"gripper_tabletop+{tmp_path / 'elsewhere'}"
            )
