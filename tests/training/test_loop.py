"""The loop: it learns, goes on bit for bit after any stop, and survives what is not finite."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open

from candata.errors import DataError, SetupError, UsageError
from candata.models import model
from candata.testing.models import SIZES, made_up_batch, made_up_normaliser, tiny_config
from candata.training import checkpoint
from candata.training.loop import train
from candata.training.settings import TrainingSettings
from candata.training.steplog import StepLog, read_log

WORKER = Path(__file__).with_name("train_worker.py")
ROOT = Path(__file__).resolve().parents[2]


def tensors(path: Path) -> dict[str, torch.Tensor]:
    with safe_open(path, "pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def same(a: Path, b: Path) -> bool:
    left, right = tensors(a), tensors(b)
    return left.keys() == right.keys() and all(torch.equal(left[name], right[name]) for name in left)


def test_it_learns_and_leaves_a_run(tmp_path, job):
    progress = train(job(steps=400, learning_rate=0.03), tmp_path / "run")
    lines = [line for line in read_log(tmp_path / "run") if "loss" in line]
    # Noise of 0.01 leaves 1e-4; the first loss is that of random weights, about 1.
    assert lines[0]["loss"] > 0.1
    assert lines[-1]["loss"] < 1e-3
    assert progress.step == 400
    assert {p.name for p in (tmp_path / "run").iterdir()} == {
        "run.json",
        "log.jsonl",
        "last.safetensors",
        "best.safetensors",
    }
    wanted = {"step", "loss", "rotation", "learning_rate", "gradient_norm", "windows_per_s", "wait_share", "elapsed_s"}
    assert wanted <= lines[0].keys()


def test_a_run_that_was_stopped_goes_on_bit_for_bit(tmp_path, job):
    train(job(), tmp_path / "whole")
    answers = iter([False] * 33 + [True])
    assert train(job(), tmp_path / "parts", should_stop=lambda: next(answers)).step == 33
    assert train(job(), tmp_path / "parts").step == 60
    for name in ("last.safetensors", "best.safetensors"):
        assert same(tmp_path / "whole" / name, tmp_path / "parts" / name)
    whole, parts = read_log(tmp_path / "whole"), read_log(tmp_path / "parts")
    assert [line["step"] for line in parts if "loss" in line] == [line["step"] for line in whole if "loss" in line]


def test_a_stopped_run_of_convolutions_goes_on_bit_for_bit(tmp_path, job):
    """Their weights lie in another order in memory than in a checkpoint, and so do the optimiser's moments."""
    kind, batch = model("contact_diffusion"), made_up_batch(4)

    def fresh():
        module = kind.build(tiny_config(kind), SIZES, made_up_normaliser())
        return replace(job(steps=6, validate_every=100), module=module, draw=lambda _step: batch, held_out=())

    train(fresh(), tmp_path / "whole")
    answers = iter([False] * 3 + [True])
    assert train(fresh(), tmp_path / "parts", should_stop=lambda: next(answers)).step == 3
    train(fresh(), tmp_path / "parts")
    assert same(tmp_path / "whole" / "last.safetensors", tmp_path / "parts" / "last.safetensors")


def test_a_killed_run_goes_on_bit_for_bit(tmp_path, job):
    train(job(steps=200), tmp_path / "whole")
    command = [sys.executable, str(WORKER), str(tmp_path / "killed"), "200"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(WORKER.parent)])}
    worker = subprocess.Popen(command, env=env)
    log = tmp_path / "killed" / "log.jsonl"
    deadline = time.monotonic() + 60
    while not (log.is_file() and log.read_text().count("\n") >= 13):
        assert worker.poll() is None, "the worker ended before it was killed"
        assert time.monotonic() < deadline, "the worker does not train"
        time.sleep(0.01)
    worker.send_signal(signal.SIGKILL)
    worker.wait()
    stood = checkpoint.read(tmp_path / "killed" / "last.safetensors").progress.step
    assert 0 < stood < 200
    train(job(steps=200), tmp_path / "killed")
    for name in ("last.safetensors", "best.safetensors"):
        assert same(tmp_path / "whole" / name, tmp_path / "killed" / name)


def test_a_finished_run_trains_no_more(tmp_path, job):
    train(job(), tmp_path)
    before = (tmp_path / "last.safetensors").stat().st_mtime_ns
    assert train(job(), tmp_path).step == 60
    assert (tmp_path / "last.safetensors").stat().st_mtime_ns == before


def test_another_run_is_refused_and_names_what_differs(tmp_path, job):
    train(job(steps=5), tmp_path)
    with pytest.raises(UsageError, match=r"expected: settings\.steps 5\n\s+found: settings\.steps 6"):
        train(job(steps=6), tmp_path)


def test_a_dataset_that_has_grown_is_said_to_have(tmp_path, job):
    train(job(), tmp_path)
    other = replace(job(), run=job().run.model_copy(update={"digest": "1" * 64, "version": 2, "normaliser": {"a": 1}}))
    with pytest.raises(UsageError, match="the dataset is another version than the run was begun on") as caught:
        train(other, tmp_path)
    assert caught.value.expected == "d, version 1, digest 000000000000"
    assert caught.value.found == "d, version 2, digest 111111111111"
    assert "--version 000000000000 to go on" in caught.value.fix


def test_a_disk_that_cannot_be_written_ends_the_run_in_one_message(tmp_path, job, monkeypatch):
    def full(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "save_file", full)
    with pytest.raises(SetupError, match=r"the run cannot be written\n\s+found: No space left") as stop:
        train(job(steps=20), tmp_path / "run")
    assert stop.value.exit_code == 3


def test_a_folder_with_other_things_is_refused(tmp_path, job):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(UsageError, match=r"thesis\.tex"):
        train(job(), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_step_that_is_not_finite_is_skipped_and_counted(tmp_path, job, batch):
    def draw(step):
        return {k: v * float("nan") if step in (7, 30) and "future" in k else v for k, v in batch(step).items()}

    progress = train(job(draw=draw), tmp_path)
    assert (progress.skipped, progress.bad_in_row, progress.step) == (2, 0, 60)
    assert all(torch.isfinite(value).all() for value in tensors(tmp_path / "last.safetensors").values())
    assert read_log(tmp_path)[-2]["skipped"] == 2


def test_a_gradient_that_is_not_finite_is_skipped(tmp_path, job):
    made = job(steps=10, bad_limit=3)
    made.module.layer.weight.register_hook(lambda grad: grad * float("inf"))
    before = made.module.layer.weight.detach().clone()
    with pytest.raises(DataError, match="diverged"):
        train(made, tmp_path)
    assert torch.equal(made.module.layer.weight, before)


def test_many_such_steps_end_the_run_and_keep_the_last_good_checkpoint(tmp_path, job, batch):
    def draw(step):
        return {k: v * float("nan") if step >= 25 and "future" in k else v for k, v in batch(step).items()}

    with pytest.raises(DataError, match=r"4 steps in a row without, up to step 29") as caught:
        train(job(draw=draw, bad_limit=4), tmp_path)
    assert "--learning-rate" in str(caught.value)
    kept = checkpoint.read(tmp_path / "last.safetensors")
    assert kept.progress.step == 20
    assert all(torch.isfinite(value).all() for value in kept.tensors("weights").values())


def test_the_best_checkpoint_is_that_of_the_least_held_out_loss(tmp_path, job):
    train(job(), tmp_path)
    held_out = {line["step"]: line["held_out_loss"] for line in read_log(tmp_path) if "held_out_loss" in line}
    best = checkpoint.read(tmp_path)
    assert best.path.name == "best.safetensors"
    assert best.progress.best_step == best.progress.step == min(held_out, key=held_out.get)


def test_the_best_checkpoint_survives_a_kill_before_it_has_its_name(tmp_path, job, monkeypatch):
    def killed(*_paths):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "copy", killed)
        with pytest.raises(KeyboardInterrupt):
            train(job(steps=20), tmp_path)
    assert not (tmp_path / "best.safetensors").exists()
    train(job(steps=20), tmp_path)
    assert checkpoint.read(tmp_path / "best.safetensors").progress.step == 20


def test_validation_leaves_the_training_as_it_is(tmp_path, job):
    train(job(), tmp_path / "with")
    train(replace(job(), held_out=()), tmp_path / "without")
    a, b = tensors(tmp_path / "with" / "last.safetensors"), tensors(tmp_path / "without" / "last.safetensors")
    assert all(torch.equal(a[name], b[name]) for name in a)


def test_the_rate_warms_up_and_decays_to_nothing():
    settings = TrainingSettings(steps=1000, warm_up=50, learning_rate=1.0)
    assert settings.rate(0, 0.0) == pytest.approx(1 / 50)
    assert settings.rate(49, 0.0) == pytest.approx(1.0, abs=0.01)
    assert settings.rate(500, 0.0) == pytest.approx(0.5)
    assert settings.rate(1000, 0.0) == pytest.approx(0.0)


def test_minutes_bound_a_run():
    settings = TrainingSettings(steps=None, minutes=2.0, warm_up=500, learning_rate=1.0)
    assert settings.share(10**6, 60.0) == 0.5
    assert settings.rate(10, 60.0) == pytest.approx(0.5)
    assert settings.share(3, 121.0) == 1.0


def test_a_run_must_end():
    with pytest.raises(ValueError, match="a run needs a length"):
        TrainingSettings(steps=None)


def test_a_torn_log_is_whole_again(tmp_path):
    with StepLog(tmp_path, 0) as log:
        for step in (5, 10, 15):
            log.write(step=step, loss=float("nan") if step == 10 else 0.5)
    path = tmp_path / "log.jsonl"
    path.write_text(path.read_text() + '{"step": 20, "lo')
    with StepLog(tmp_path, 10) as log:
        log.write(step=12)
    assert [json.loads(line) for line in path.read_text().splitlines()] == [
        {"step": 5, "loss": 0.5},
        {"step": 10, "loss": None},
        {"step": 12},
    ]


@pytest.mark.hard
def test_of_two_that_train_into_one_folder_the_second_is_refused_and_changes_nothing(tmp_path, job):
    command = [sys.executable, str(WORKER), str(tmp_path / "run"), "10000"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(WORKER.parent)])}
    with subprocess.Popen(command, env=env) as worker:
        deadline = time.monotonic() + 60
        while not (tmp_path / "run" / "last.safetensors").is_file():
            assert worker.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        for other in (job(steps=10_000), job(steps=5)):
            with pytest.raises(UsageError, match="another process trains into this folder"):
                train(other, tmp_path / "run")
        assert json.loads((tmp_path / "run" / "run.json").read_text())["settings"]["steps"] == 10_000
        worker.kill()
    answers = iter([False, True])  # the system has released the lock of the killed one
    assert train(job(steps=10_000), tmp_path / "run", should_stop=lambda: next(answers)).step > 1


@pytest.mark.hard
def test_a_run_that_is_renamed_in_mid_run_is_said_and_not_made_anew(tmp_path, job, batch):
    train(job(steps=60), tmp_path / "whole")

    def draw(step):
        if step == 25:
            (tmp_path / "run").rename(tmp_path / "away")
        return batch(step)

    with pytest.raises(SetupError, match=r"the run cannot be written\n\s+found: No such file"):
        train(job(steps=60, draw=draw), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    assert train(job(steps=60), tmp_path / "away").step == 60
    assert same(tmp_path / "whole" / "last.safetensors", tmp_path / "away" / "last.safetensors")
