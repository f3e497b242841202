"""Jobs from datasets, and everything that a user may give wrongly."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from candata.errors import DataError, SetupError, UnknownNameError, UsageError
from candata.loaders import Augmentation, make_split, parse_mixture, save_split
from candata.training import checkpoint, evaluation, jobs
from candata.training.evaluated_runs import EvaluatedRun
from candata.training.evaluation import EvaluationSettings, evaluate
from candata.training.jobs import TrainRequest, prepare
from candata.training.loop import train
from candata.training.settings import TrainingSettings

SETTINGS = TrainingSettings(steps=6, batch=8, validate_every=3, log_every=2)
SMALL = {"latent": 16, "temporal_width": 16, "widths": (16, 16), "time_features": 8, "point_widths": (8, 16)}
MLP = TrainRequest("mlp", config={"width": 16, "layers": 1}, history=4, horizon=6)
DIFFUSION = TrainRequest("contact_diffusion", config=SMALL, history=4, horizon=6)


def seen_count(run, data, group):
    """How many of the episodes evaluated on the run was trained on."""
    (facts,) = evaluate([run], data, EvaluationSettings(group, 1, 1, 6))[0].models.values()
    return facts.seen_episodes


@pytest.fixture
def trained(tmp_path, dataset):
    """A few steps of the small contact model: its run and its data."""
    data = dataset()
    train(prepare(data, DIFFUSION, SETTINGS), tmp_path / "run")
    return tmp_path / "run", data


def test_a_run_names_its_data(trained):
    folder, data = trained
    run = json.loads((folder / "run.json").read_text())
    assert (run["dataset"], run["digest"]) == ("glide", data.digest)
    assert run["joint_names"] == run["actuator_names"] == ["a", "b"]
    assert run["units"] == {
        "object_pose": "m",
        "joint_position": "joint",
        "action": "joint",
        "contact": "1",
        "increments": "m, rad",
    }
    assert run["normaliser"]["digest"] == data.digest
    assert run["sizes"] | {"history": 4, "horizon": 6, "points": 40} == run["sizes"]
    split = json.loads((folder / "split.json").read_text())
    assert (len(split["train"]), len(split["val"]), len(split["test"])) == (8, 1, 1)


def test_diffusion_goes_on_bit_for_bit(tmp_path, trained):
    folder, data = trained
    answers = iter([False] * 4 + [True])
    train(prepare(data, DIFFUSION, SETTINGS), tmp_path / "parts", should_stop=lambda: next(answers))
    train(prepare(data, DIFFUSION, SETTINGS), tmp_path / "parts")
    whole, parts = (checkpoint.read(path / "last.safetensors") for path in (folder, tmp_path / "parts"))
    for group in ("weights", "ema", "optimiser"):
        a, b = whole.tensors(group), parts.tensors(group)
        assert a.keys() == b.keys()
        assert all(torch.equal(a[name], b[name]) for name in a)


def test_evaluation_is_complete_and_repeatable(trained):
    folder, data = trained
    found, tracks = evaluate([folder], data, EvaluationSettings(samples=3, steps=2, execute=4))
    assert list(found.forecasters) == ["run", "stays", "keeps_velocity"]
    facts = found.models["run"]
    assert (facts.model, facts.seen_episodes, facts.contact_from) == ("contact_diffusion", 0, "predicted")
    assert (facts.preset, facts.planned_actions, found.episodes) == ("small", True, 1)
    assert len(found.forecasters["run"].windows.position_error_m) == 6
    assert found.forecasters["keeps_velocity"].closed_loop.adds_auc > 0.99
    assert tracks[0].poses.keys() == found.forecasters.keys()
    assert evaluate([folder], data, EvaluationSettings(samples=3, steps=2, execute=4))[0] == found
    assert type(found).model_validate_json(found.model_dump_json()) == found


def test_episodes_that_were_trained_on_are_counted(trained):
    folder, data = trained
    assert seen_count(folder, data, "train") == 8
    assert seen_count(folder, data, "all") == 8


def test_a_checkpoint_alone_does_not_forget_what_it_was_trained_on(tmp_path, trained, dataset):
    folder, data = trained
    alone = tmp_path / "alone" / "model.safetensors"
    alone.parent.mkdir()
    alone.write_bytes((folder / "best.safetensors").read_bytes())
    assert seen_count(alone, data, "train") == 8
    assert seen_count(alone, dataset("other"), "all") is None


def test_episodes_of_the_first_run_are_not_forgotten_by_fine_tuning(tmp_path, trained, dataset):
    folder, data = trained
    tuned = tmp_path / "tuned"
    train(prepare(dataset("other", episodes=3), TrainRequest(init=folder), SETTINGS), tuned)
    assert seen_count(tuned, data, "train") == 8
    assert seen_count(tuned, data, "test") == 0


def test_a_split_that_is_damaged_or_anothers_is_refused(trained):
    folder, data = trained
    path = folder / "split.json"
    other = json.loads(path.read_bytes())
    other["train"], other["test"] = other["test"], other["train"]
    for text, said in (
        (b"{", "is damaged"),
        (b"\xff\xfe", "is damaged"),
        (json.dumps(other).encode(), "of another run"),
    ):
        path.write_bytes(text)
        with pytest.raises(UsageError, match=said):
            evaluate([folder], data, EvaluationSettings("test", 1, 1, 6))


def test_fingertips_that_are_replayed_are_said_to_be(trained):
    folder, _ = trained
    run = checkpoint.read(folder).run
    more = run.model_copy(update={"config": run.config | {"fingertip_contact": True}})
    one, other = (EvaluatedRun("run", SimpleNamespace(run=each), 6) for each in (run, more))
    assert evaluation.contact_from(one, True) == "predicted"
    assert evaluation.contact_from(one, False) == "recorded"
    assert evaluation.contact_from(other, True) == "predicted, fingertips recorded"


def test_a_model_without_contact(tmp_path, dataset):
    data = dataset(contact=False, cloud=False)
    train(prepare(data, MLP, SETTINGS), tmp_path / "run")
    found, tracks = evaluate([tmp_path / "run"], data, EvaluationSettings(samples=2, execute=4))
    assert found.models["run"].contact_from == "not read"
    assert found.pairs == ()
    assert found.forecasters["run"].windows.contact is None
    assert tracks[0].contact is None


def test_fine_tuning_begins_with_the_averaged_weights(trained, dataset):
    folder, _ = trained
    other = dataset("other", episodes=12)
    job = prepare(other, TrainRequest(init=folder), SETTINGS)
    kept = checkpoint.read(folder)
    weights = job.module.state_dict()
    assert all(torch.equal(weights[name], value) for name, value in kept.tensors("ema").items())
    assert job.run.normaliser == kept.run.normaliser
    assert (job.run.digest, job.run.init["digest"]) == (other.digest, kept.run.digest)
    assert job.run.config == kept.run.config


def test_fine_tuning_keeps_the_model(trained, dataset):
    folder, data = trained
    with pytest.raises(UsageError, match="fine-tuning keeps the model"):
        prepare(data, TrainRequest("mlp", init=folder), SETTINGS)


def test_other_joints_are_refused_and_both_named(trained, dataset):
    folder, _ = trained
    other = dataset("other", joint_names=("a", "c"))
    with pytest.raises(UsageError, match=r"other joint names\n\s+expected: 2: a, b\n\s+found: 2: a, c"):
        prepare(other, TrainRequest(init=folder), SETTINGS)
    with pytest.raises(UsageError, match=r"expected: 2: a, b\n\s+found: 2: a, c"):
        evaluate([folder], other, EvaluationSettings())


def test_another_horizon_is_refused(trained):
    folder, data = trained
    with pytest.raises(UsageError, match=r"other sizes\n\s+expected: .*horizon 6.*\n\s+found: .*horizon 5"):
        prepare(data, TrainRequest(init=folder, horizon=5), SETTINGS)


def test_data_without_contact(dataset):
    with pytest.raises(DataError, match="contact"):
        prepare(dataset(contact=False), DIFFUSION, SETTINGS)


def test_a_horizon_longer_than_the_episodes(trained, dataset):
    folder, _ = trained
    with pytest.raises(DataError, match="no episode is long enough for a window"):
        prepare(dataset("short", rows=9, episodes=3), MLP, SETTINGS)
    with pytest.raises(DataError, match="no episode is long enough for a window"):
        evaluate([folder], dataset("shorter", rows=7, episodes=3), EvaluationSettings("all"))


def test_an_empty_group_is_named(tmp_path, dataset):
    data = dataset()
    save_split(data, make_split(data, {"val": 0.5, "test": 0.5}), "none")
    with pytest.raises(DataError, match="the group train of the split is empty"):
        prepare(data, TrainRequest("mlp", split="none"), SETTINGS)
    save_split(data, make_split(data, {"train": 1.0}), "all")
    train(
        prepare(data, TrainRequest("mlp", config=MLP.config, history=4, horizon=6, split="all"), SETTINGS),
        tmp_path / "run",
    )
    assert not (tmp_path / "run" / "best.safetensors").exists()
    with pytest.raises(DataError, match="the group test of the split is empty"):
        evaluate([tmp_path / "run"], data, EvaluationSettings())


def test_unknown_names_list_the_known(dataset):
    data = dataset()
    with pytest.raises(UnknownNameError, match="did you mean 'mlp'"):
        prepare(data, TrainRequest("mpl"), SETTINGS)
    with pytest.raises(UnknownNameError, match="base, paper, small"):
        prepare(data, TrainRequest("mlp", preset="smal"), SETTINGS)
    with pytest.raises(UsageError, match="widht"):
        prepare(data, TrainRequest("mlp", config={"widht": 3}), SETTINGS)
    with pytest.raises(UsageError, match="no model"):
        prepare(data, TrainRequest(), SETTINGS)


@pytest.mark.parametrize(
    ("manner", "name"),
    [
        (EvaluationSettings(samples=0), "samples"),
        (EvaluationSettings(steps=101), "steps"),
        (EvaluationSettings(execute=7), "execute"),
    ],
)
def test_numbers_out_of_range(trained, manner, name):
    with pytest.raises(UsageError, match=f"--{name} is out of range"):
        evaluate([trained[0]], trained[1], manner)


def test_an_unknown_group(trained):
    with pytest.raises(UnknownNameError, match="all, test, train, val"):
        evaluate([trained[0]], trained[1], EvaluationSettings("tset"))


def test_no_such_device(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(SetupError, match="no CUDA device"):
        jobs.check_device("cuda")
    with pytest.raises(UnknownNameError, match="cpu, cuda"):
        jobs.check_device("tpu")


def test_the_seed_decides_the_first_weights(dataset):
    data = dataset()
    first, same, other = (
        prepare(data, MLP, SETTINGS.model_copy(update={"seed": seed})).module.state_dict() for seed in (1, 1, 2)
    )
    name = next(name for name in first if name.endswith("weight"))
    assert torch.equal(first[name], same[name])
    assert not torch.equal(first[name], other[name])


MIX = {"mixture": parse_mixture("glide:0.75,real:0.25")}


@pytest.fixture
def mixture(tmp_path, dataset):
    """A few steps of a small model on two datasets: its run and both."""
    sources = {"glide": dataset(), "real": dataset("real", episodes=12, source="real")}
    job = prepare(sources, replace(MLP, **MIX), SETTINGS)
    train(job, tmp_path / "mixed")
    return tmp_path / "mixed", sources, job


def test_a_run_on_a_mixture_names_its_sources(mixture):
    folder, sources, job = mixture
    run = json.loads((folder / "run.json").read_text())
    assert (run["dataset"], run["version"]) == ("glide:0.75,real:0.25", 0)
    told = [(one["name"], one["share"], one["digest"]) for one in run["sources"]]
    assert told == [("glide", 0.75, sources["glide"].digest), ("real", 0.25, sources["real"].digest)]
    assert [(one.name, one.drawn) for one in job.effective(6)] == [("glide", 36), ("real", 12)]
    assert np.bincount(job.draw(0)["domain"]).tolist() == [6, 2]
    held_out = torch.cat([batch["domain"] for batch in job.held_out])
    # Glide has one episode for validation, real one too: the shares come from the mixture.
    assert held_out.double().mean() == pytest.approx(0.25, abs=1 / len(held_out))
    assert run["normaliser"]["episodes"] == 8 + 10


def test_a_run_on_a_mixture_is_evaluated_by_the_split_of_each_source(mixture):
    folder, sources, _ = mixture
    for name, train_episodes in (("glide", 8), ("real", 10)):
        assert seen_count(folder, sources[name], "test") == 0
        assert seen_count(folder, sources[name], "train") == train_episodes
    split = json.loads((folder / "split.json").read_text())
    split["splits"]["real"] = split["splits"]["glide"]
    (folder / "split.json").write_text(json.dumps(split))
    with pytest.raises(UsageError, match="of another run"):
        evaluate([folder], sources["real"], EvaluationSettings("test", 1, 1, 6))


def test_a_run_on_a_mixture_goes_on_and_refuses_other_shares(tmp_path, mixture):
    folder, sources, _ = mixture
    answers = iter([False] * 4 + [True])
    ask = replace(MLP, **MIX)
    train(prepare(sources, ask, SETTINGS), tmp_path / "parts", should_stop=lambda: next(answers))
    train(prepare(sources, ask, SETTINGS), tmp_path / "parts")
    whole, parts = (
        checkpoint.read(path / "last.safetensors").tensors("weights") for path in (folder, tmp_path / "parts")
    )
    assert all(torch.equal(whole[name], parts[name]) for name in whole)
    other = replace(MLP, mixture=parse_mixture("glide:0.5,real:0.5"))
    with pytest.raises(UsageError, match=r"other settings\n\s+expected: .*glide:0.75"):
        train(prepare(sources, other, SETTINGS), folder)


def test_one_source_may_lack_held_out_episodes(dataset):
    sources = {"glide": dataset(), "real": dataset("real", episodes=3)}
    save_split(sources["real"], make_split(sources["real"], {"train": 1.0}), "all")
    save_split(sources["glide"], make_split(sources["glide"]), "all")
    job = prepare(sources, replace(MLP, split="all", **MIX), SETTINGS)
    assert all((batch["domain"] == 0).all() for batch in job.held_out)


def test_datasets_and_mixture_must_meet(dataset):
    data = dataset()
    with pytest.raises(UsageError, match="several datasets need a mixture"):
        prepare({"glide": data}, MLP, SETTINGS)
    with pytest.raises(UsageError, match="several datasets need a mixture"):
        prepare(data, replace(MLP, **MIX), SETTINGS)
    with pytest.raises(UnknownNameError, match="'real'"):
        prepare({"glide": data}, replace(MLP, **MIX), SETTINGS)
    with pytest.raises(DataError, match="differ in their joint names"):
        prepare({"glide": data, "real": dataset("real", joint_names=("a", "c"))}, replace(MLP, **MIX), SETTINGS)


def test_noise_reaches_the_batches_that_are_trained_on_alone(dataset):
    data = dataset()
    noisy = SETTINGS.model_copy(update={"augment": Augmentation(position_m=0.01, rotation_rad=0.1, command=0.1)})
    plain, job, again = (prepare(data, MLP, settings) for settings in (SETTINGS, noisy, noisy))
    for name in ("history/object_pose", "planned/action"):
        assert not torch.equal(job.draw(3)[name], plain.draw(3)[name])
        assert torch.equal(job.draw(3)[name], again.draw(3)[name])
        assert torch.equal(job.held_out[0][name], plain.held_out[0][name])
    assert torch.equal(job.draw(3)["future_pad"], plain.draw(3)["future_pad"])


def test_the_method_of_the_normaliser_is_chosen_once(trained, dataset):
    job = prepare(dataset("more"), replace(MLP, normaliser="quantile"), SETTINGS)
    assert job.run.normaliser["method"] == "quantile"
    assert job.run.normaliser["clipped"]["joint_position"] > 0
    batch = dict(job.draw(0))
    batch["history/joint_position"] = batch["history/joint_position"] + 1e6
    assert job.module.reader(batch).history.abs().max() < 1e4
    with pytest.raises(UsageError, match="fine-tuning keeps the normaliser"):
        prepare(trained[1], TrainRequest(init=trained[0], normaliser="std"), SETTINGS)
    with pytest.raises(UnknownNameError, match="did you mean 'quantile'"):
        prepare(trained[1], replace(MLP, normaliser="quantil"), SETTINGS)


def test_data_without_clouds_are_evaluated_by_a_model_that_reads_none(tmp_path, trained, dataset):
    folder, data = trained
    bare = dataset("bare", cloud=False)
    train(prepare(data, MLP, SETTINGS), tmp_path / "mlp")
    found, _ = evaluate([tmp_path / "mlp"], bare, EvaluationSettings("all", 1, 1, 6))
    assert found.episodes == 10
    with pytest.raises(UsageError, match="made for other sizes"):
        evaluate([folder], bare, EvaluationSettings("all", 1, 1, 6))
