"""Jobs from datasets, and everything that a user may give wrongly."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
import torch

from candata.errors import DataError, SetupError, UnknownNameError, UsageError
from candata.loaders import make_split, save_split
from candata.training import checkpoint, evaluation, jobs
from candata.training.evaluation import Manner, evaluate
from candata.training.jobs import Ask, prepare
from candata.training.loop import train
from candata.training.settings import Settings

SETTINGS = Settings(steps=6, batch=8, validate_every=3, log_every=2)
SMALL = {"latent": 16, "temporal_width": 16, "widths": (16, 16), "time_features": 8, "point_widths": (8, 16)}
MLP = Ask("mlp", config={"width": 16, "layers": 1}, history=4, horizon=6)
DIFFUSION = Ask("contact_diffusion", config=SMALL, history=4, horizon=6)


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
        "object_pose": "m", "joint_position": "joint", "action": "joint", "contact": "1", "increments": "m, rad"
    }  # fmt: skip
    assert run["normaliser"]["digest"] == data.digest
    assert run["sizes"] | {"history": 4, "horizon": 6, "points": 40} == run["sizes"]
    split = json.loads((folder / "split.json").read_text())
    assert (len(split["train"]), len(split["val"]), len(split["test"])) == (8, 1, 1)


def test_diffusion_goes_on_bit_for_bit(tmp_path, trained):
    folder, data = trained
    answers = iter([False] * 4 + [True])
    train(prepare(data, DIFFUSION, SETTINGS), tmp_path / "parts", stopped=lambda: next(answers))
    train(prepare(data, DIFFUSION, SETTINGS), tmp_path / "parts")
    whole, parts = (checkpoint.read(path / "last.safetensors") for path in (folder, tmp_path / "parts"))
    for group in ("weights", "ema", "optimiser"):
        a, b = whole.tensors(group), parts.tensors(group)
        assert a.keys() == b.keys()
        assert all(torch.equal(a[name], b[name]) for name in a)


def test_evaluation_is_complete_and_repeatable(trained):
    folder, data = trained
    found, tracks = evaluate(folder, data, Manner(samples=3, steps=2, execute=4))
    assert list(found.forecasters) == ["contact_diffusion", "stays", "keeps_velocity"]
    assert (found.seen_episodes, found.episodes, found.contact_from) == (0, 1, "predicted")
    assert len(found.forecasters["contact_diffusion"].windows.position_error_m) == 6
    assert found.forecasters["keeps_velocity"].closed_loop.adds_auc > 0.99
    assert tracks[0].poses.keys() == found.forecasters.keys()
    assert evaluate(folder, data, Manner(samples=3, steps=2, execute=4))[0] == found
    assert type(found).model_validate_json(found.model_dump_json()) == found


def test_episodes_that_were_trained_on_are_counted(trained):
    folder, data = trained
    assert evaluate(folder, data, Manner("train", 1, 1, 6))[0].seen_episodes == 8
    assert evaluate(folder, data, Manner("all", 1, 1, 6))[0].seen_episodes == 8


def test_a_checkpoint_alone_does_not_forget_what_it_was_trained_on(tmp_path, trained, dataset):
    folder, data = trained
    alone = tmp_path / "alone" / "model.safetensors"
    alone.parent.mkdir()
    alone.write_bytes((folder / "best.safetensors").read_bytes())
    assert evaluate(alone, data, Manner("train", 1, 1, 6))[0].seen_episodes == 8
    assert evaluate(alone, dataset("other"), Manner("all", 1, 1, 6))[0].seen_episodes is None


def test_episodes_of_the_first_run_are_not_forgotten_by_fine_tuning(tmp_path, trained, dataset):
    folder, data = trained
    tuned = tmp_path / "tuned"
    train(prepare(dataset("other", episodes=3), Ask(init=folder), SETTINGS), tuned)
    assert evaluate(tuned, data, Manner("train", 1, 1, 6))[0].seen_episodes == 8
    assert evaluate(tuned, data, Manner("test", 1, 1, 6))[0].seen_episodes == 0


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
            evaluate(folder, data, Manner("test", 1, 1, 6))


def test_fingertips_that_are_replayed_are_said_to_be(trained):
    folder, _ = trained
    run = checkpoint.read(folder).run
    more = run.model_copy(update={"config": run.config | {"fingertip_contact": True}})
    scores = SimpleNamespace(closed_loop={"contact_diffusion": SimpleNamespace(contact=object())})
    assert evaluation._contact_from(run, scores) == "predicted"
    assert evaluation._contact_from(more, scores) == "predicted, fingertips recorded"


def test_a_model_without_contact(tmp_path, dataset):
    data = dataset(contact=False, cloud=False)
    train(prepare(data, MLP, SETTINGS), tmp_path / "run")
    found, tracks = evaluate(tmp_path / "run", data, Manner(samples=2, execute=4))
    assert found.contact_from == "not read"
    assert found.gain == {}
    assert found.forecasters["mlp"].windows.contact is None
    assert tracks[0].contact is None


def test_fine_tuning_begins_with_the_averaged_weights(trained, dataset):
    folder, _ = trained
    other = dataset("other", episodes=12)
    job = prepare(other, Ask(init=folder), SETTINGS)
    kept = checkpoint.read(folder)
    weights = job.module.state_dict()
    assert all(torch.equal(weights[name], value) for name, value in kept.tensors("ema").items())
    assert job.run.normaliser == kept.run.normaliser
    assert (job.run.digest, job.run.init["digest"]) == (other.digest, kept.run.digest)
    assert job.run.config == kept.run.config


def test_fine_tuning_keeps_the_model(trained, dataset):
    folder, data = trained
    with pytest.raises(UsageError, match="fine-tuning keeps the model"):
        prepare(data, Ask("mlp", init=folder), SETTINGS)


def test_other_joints_are_refused_and_both_named(trained, dataset):
    folder, _ = trained
    other = dataset("other", joint_names=("a", "c"))
    with pytest.raises(UsageError, match=r"other joint names\n\s+expected: 2: a, b\n\s+found: 2: a, c"):
        prepare(other, Ask(init=folder), SETTINGS)
    with pytest.raises(UsageError, match=r"expected: 2: a, b\n\s+found: 2: a, c"):
        evaluate(folder, other, Manner())


def test_another_horizon_is_refused(trained):
    folder, data = trained
    with pytest.raises(UsageError, match=r"other sizes\n\s+expected: .*horizon 6.*\n\s+found: .*horizon 5"):
        prepare(data, Ask(init=folder, horizon=5), SETTINGS)


def test_data_without_contact(dataset):
    with pytest.raises(DataError, match="contact"):
        prepare(dataset(contact=False), DIFFUSION, SETTINGS)


def test_a_horizon_longer_than_the_episodes(trained, dataset):
    folder, _ = trained
    with pytest.raises(DataError, match="no episode is long enough for a window"):
        prepare(dataset("short", rows=9, episodes=3), MLP, SETTINGS)
    with pytest.raises(DataError, match="no episode is long enough for a window"):
        evaluate(folder, dataset("shorter", rows=7, episodes=3), Manner("all"))


def test_an_empty_group_is_named(tmp_path, dataset):
    data = dataset()
    save_split(data, make_split(data, {"val": 0.5, "test": 0.5}), "none")
    with pytest.raises(DataError, match="the group train of the split is empty"):
        prepare(data, Ask("mlp", split="none"), SETTINGS)
    save_split(data, make_split(data, {"train": 1.0}), "all")
    train(prepare(data, Ask("mlp", config=MLP.config, history=4, horizon=6, split="all"), SETTINGS), tmp_path / "run")
    assert not (tmp_path / "run" / "best.safetensors").exists()
    with pytest.raises(DataError, match="the group test of the split is empty"):
        evaluate(tmp_path / "run", data, Manner())


def test_unknown_names_list_the_known(dataset):
    data = dataset()
    with pytest.raises(UnknownNameError, match="did you mean 'mlp'"):
        prepare(data, Ask("mpl"), SETTINGS)
    with pytest.raises(UnknownNameError, match="base, paper, small"):
        prepare(data, Ask("mlp", preset="smal"), SETTINGS)
    with pytest.raises(UsageError, match="widht"):
        prepare(data, Ask("mlp", config={"widht": 3}), SETTINGS)
    with pytest.raises(UsageError, match="no model"):
        prepare(data, Ask(), SETTINGS)


@pytest.mark.parametrize(
    ("manner", "name"), [(Manner(samples=0), "samples"), (Manner(steps=101), "steps"), (Manner(execute=7), "execute")]
)
def test_numbers_out_of_range(trained, manner, name):
    with pytest.raises(UsageError, match=f"--{name} is out of range"):
        evaluate(*trained, manner)


def test_an_unknown_group(trained):
    with pytest.raises(UnknownNameError, match="all, test, train, val"):
        evaluate(*trained, Manner("tset"))


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
