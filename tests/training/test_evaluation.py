"""Several runs on one page: how they are named, what makes them comparable, and what is refused before any work."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import CandataError, UsageError
from candata.loaders import make_split, save_split
from candata.schema.manifest import Lineage
from candata.training.evaluated_runs import refuse_seen, run_names
from candata.training.evaluation import EvaluationSettings, evaluate
from candata.training.jobs import TrainRequest, prepare
from candata.training.loop import train
from candata.training.settings import TrainingSettings

SETTINGS = TrainingSettings(steps=2, batch=8)
MLP = TrainRequest("mlp", config={"width": 16, "layers": 1}, history=4, horizon=6)
QUICK = EvaluationSettings(samples=1, steps=1)


@pytest.fixture
def make_run(tmp_path):
    """Trains two steps of a small net: `make_run(data, "name", history=...)`."""

    def make(data, name: str, **changes: object) -> Path:
        train(prepare(data, replace(MLP, **changes), SETTINGS), tmp_path / name)
        return tmp_path / name

    return make


def test_models_of_other_windows_and_channels_stand_on_one_page(make_run, dataset):
    data = dataset()
    small = {"latent": 16, "temporal_width": 16, "widths": (16, 16), "time_features": 8, "point_widths": (8, 16)}
    first = make_run(data, "first", history=3, horizon=5)
    second = make_run(data, "second", model="contact_diffusion", config=small)
    found, tracks = evaluate([first, second], data, replace(QUICK, execute=4))
    assert list(found.forecasters) == ["first", "second", "stays", "keeps_velocity"]
    assert (found.begins_after, found.models["first"].history, found.models["second"].horizon) == (4, 3, 6)
    assert len(found.pairs) == 6
    by_name = {name: scores.closed_loop.adds_auc for name, scores in found.forecasters.items()}
    pair = found.pair("second", "first")
    assert pair.value == pytest.approx(by_name["second"] - by_name["first"], abs=1e-12)
    assert found.pair("first", "second") == pair.reversed()
    # What a model scores does not hang on who stands beside it, but for the row at which loops begin.
    alone = evaluate([second], data, replace(QUICK, execute=4, baselines=False))[0]
    assert list(alone.forecasters) == ["second"]
    assert alone.forecasters["second"] == found.forecasters["second"]
    # The diffusion model draws its samples: they are followed one by one in the first and the last of the episodes.
    (sampled,) = (track.sampled["second"] for track in tracks)
    assert sampled.shape == (8, len(tracks[0].truth), 7)
    assert sampled.std(axis=0)[-1, 0] > 0
    assert found.notes == ("no simulator beside them: the recordings name no scene",)


def test_joints_that_follow_a_servo_are_said_to(make_run, dataset):
    data = dataset()
    run = make_run(data, "run")
    recorded, servo = (evaluate([run], data, replace(QUICK, joints=joints))[0] for joints in ("recorded", "servo"))
    assert (recorded.joints_from, servo.joints_from) == ("recorded", "servo")
    assert recorded.forecasters["run"].windows == servo.forecasters["run"].windows
    assert recorded.forecasters["run"].closed_loop != servo.forecasters["run"].closed_loop
    assert recorded.forecasters["stays"] == servo.forecasters["stays"]
    fitted_on = "the servos were fitted on episodes that are scored here"
    assert fitted_on not in servo.notes
    assert fitted_on in evaluate([], data, replace(QUICK, joints="servo", group="all"))[0].notes


def test_baselines_need_no_run(dataset):
    found, tracks = evaluate([], dataset(), replace(QUICK, group="all"))
    assert list(found.forecasters) == ["stays", "keeps_velocity"]
    assert (found.models, found.episodes) == ({}, 10)
    assert not any(track.sampled for track in tracks)
    with pytest.raises(UsageError, match="--execute is out of range"):
        evaluate([], dataset("short"), replace(QUICK, shape={"horizon": 4}, execute=5))
    with pytest.raises(UsageError, match="history"):
        evaluate([], dataset("without"), replace(QUICK, shape={"history": 0}))
    with pytest.raises(UsageError, match="nothing to evaluate"):
        evaluate([], dataset("other"), replace(QUICK, baselines=False))


def test_equal_names_are_told_apart_by_their_folders(tmp_path):
    for name in ("a/first", "b/first", "second", "stays"):
        (tmp_path / name).mkdir(parents=True)
    file = tmp_path / "second" / "best.safetensors"
    file.touch()
    paths = [tmp_path / "a" / "first", tmp_path / "b" / "first", tmp_path / "second", file]
    assert run_names(paths) == ("a/first", "b/first", "second", "second/best")
    assert run_names([tmp_path / "stays"], ("stays",)) == (f"{tmp_path.name}/stays",)
    with pytest.raises(UsageError, match="a run is named twice"):
        run_names([tmp_path / "second", tmp_path / "a" / ".." / "second"])


def test_runs_of_other_rates_are_refused(make_run, dataset):
    data = dataset()
    runs = [make_run(data, "tens"), make_run(data, "fives", rate_hz=5.0)]
    with pytest.raises(UsageError, match=r"different rates\n\s+expected: 10 Hz, as tens\n\s+found: 5 Hz"):
        evaluate(runs, data, QUICK)


def test_runs_of_other_splits_are_refused(make_run, dataset):
    data = dataset()
    save_split(data, make_split(data, seed=0), "one")
    save_split(data, make_split(data, seed=1), "other")
    runs = [make_run(data, "first", split="one"), make_run(data, "second", split="other")]
    with pytest.raises(UsageError, match="different splits of the dataset"):
        evaluate(runs, data, QUICK)


def test_test_episodes_that_an_ancestor_has_seen_are_refused_with_their_ids(make_run, dataset, tmp_path):
    data = dataset()
    save_split(data, make_split(data, {"train": 0.5, "val": 0.1, "test": 0.4}), "half")
    first = make_run(data, "first", split="half")
    seen = json.loads((first / "split.json").read_text())["train"]
    tuned = tmp_path / "tuned"
    train(prepare(dataset("other", episodes=3), TrainRequest(init=first), SETTINGS), tuned)
    # By the default split, which the tuned run was not trained by, the test holds what the first run trained on.
    save_split(data, make_split(data, {"train": 0.1, "val": 0.1, "test": 0.8}, seed=4), "default")
    with pytest.raises(UsageError) as refusal:
        evaluate([tuned], data, QUICK)
    assert "tuned was trained on episodes of the group test" in str(refusal.value)
    assert any(name in str(refusal.value) for name in seen)
    found, _ = evaluate([tuned], data, replace(QUICK, group="all"))
    assert found.models["tuned"].seen_episodes == len(seen)


def test_a_dataset_that_grew_is_evaluated_by_the_split_of_the_run(make_run, dataset):
    data = dataset()
    run = make_run(data, "run")
    before = evaluate([run], data, QUICK)[0].forecasters["run"]
    append(data.path, dataset("more", episodes=20).episodes(), Lineage(operation="test"))
    grown = open_dataset(data.path)
    assert (len(grown), grown.digests) == (30, (grown.digest, data.digest))
    assert evaluate([run], grown, QUICK)[0].forecasters["run"] == before


def test_a_long_list_of_seen_ids_is_cut():
    run = SimpleNamespace(name="run", checkpoint=SimpleNamespace(path="run/best.safetensors"))
    with pytest.raises(UsageError, match=r"9 seen: e0, e1, e2, e3, e4 and 4 more"):
        refuse_seen(run, [f"e{k}" for k in range(9)], "test")


def test_channels_in_other_units_are_refused(make_run, dataset, tmp_path):
    run = make_run(dataset(), "run")
    folder = create_dataset(tmp_path / "raw", name="raw")
    episodes = [replace(e, meta=e.meta.model_copy(update={"unscaled": ("action",)})) for e in dataset("counts")]
    append(folder, episodes, Lineage(operation="test"))
    with pytest.raises(UsageError, match=r"another unit here\n\s+expected: action in joint, as run was trained on"):
        evaluate([run], open_dataset(folder), replace(QUICK, group="all"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"simulator": True}, "the recordings name no scene"),
        ({"effects": ()}, "the recordings name no scene"),
        ({"scene": "xhand_tabletop"}, "does not fit scene xhand_tabletop"),
        ({"scene": "xhand_tabletop", "simulator": False}, "leave --no-simulator out"),
        ({"joints": "servos"}, "did you mean 'servo'"),
    ],
)
def test_a_simulator_that_cannot_be_had_is_refused_before_any_forecast(dataset, changes, said):
    stages = []
    with pytest.raises(CandataError, match=said):
        evaluate([], dataset(), replace(QUICK, group="all", **changes), stages.append)
    assert not any("windows" in stage for stage in stages)
