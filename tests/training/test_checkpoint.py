"""Checkpoints: whole or absent, never a pickle, and only for the data they were made for."""

from __future__ import annotations

import pickle
import resource
import signal

import pytest
import torch
from safetensors.torch import save_file

from candata.errors import DataError, SetupError, UsageError
from candata.training import checkpoint, ema, steplog
from candata.training.loop import train


def test_a_checkpoint_names_what_it_is(tmp_path, job):
    made = job()
    train(made, tmp_path)
    kept = checkpoint.read(tmp_path / "last.safetensors")
    assert kept.run == made.run
    assert kept.progress.step == 60
    assert kept.tensors("weights").keys() == kept.tensors("ema").keys() == {"layer.weight", "layer.bias", "scale"}
    assert kept.tensors("optimiser").keys() == {f"{i}/{k}" for i in (0, 1) for k in ("step", "exp_avg", "exp_avg_sq")}


def write_pickle(path, module):
    path.write_bytes(pickle.dumps({"weight": [1.0]}))


def write_torch(path, module):
    torch.save(module.state_dict(), path)


def write_old_torch(path, module):
    torch.save(module.state_dict(), path, _use_new_zipfile_serialization=False)


@pytest.mark.parametrize("write", [write_pickle, write_torch, write_old_torch])
def test_a_pickle_is_refused_whatever_its_name(tmp_path, job, write):
    for name in ("model.pt", "last.safetensors"):
        path = tmp_path / name
        write(path, job().module)
        with pytest.raises(UsageError, match="is a pickle, which can run any code when opened: refused"):
            checkpoint.read(path)
    with pytest.raises(UsageError, match="is a pickle"):
        checkpoint.read(tmp_path)


def test_another_safetensors_file_is_refused(tmp_path):
    save_file({"a": torch.zeros(2)}, tmp_path / "a.safetensors")
    with pytest.raises(UsageError, match="not a checkpoint of candata"):
        checkpoint.read(tmp_path / "a.safetensors")


@pytest.mark.parametrize("damage", [b"", b"garbage and more garbage", "half"])
def test_a_damaged_file_is_named(tmp_path, job, damage):
    train(job(steps=5), tmp_path)
    path = tmp_path / "last.safetensors"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2] if damage == "half" else damage)
    with pytest.raises(DataError, match=r"last\.safetensors"):
        checkpoint.read(path)


def test_no_checkpoint_at_all(tmp_path):
    with pytest.raises(UsageError, match="the folder holds no checkpoint"):
        checkpoint.read(tmp_path)
    with pytest.raises(UsageError, match="no such checkpoint"):
        checkpoint.read(tmp_path / "nothing")


def test_a_save_that_fails_leaves_the_old_one(tmp_path, job, monkeypatch):
    made = job()
    train(made, tmp_path)
    path = tmp_path / "last.safetensors"
    before = path.read_bytes()

    def full(tensors, target, header):
        target.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "save_file", full)
    with pytest.raises(SetupError, match="No space"):
        checkpoint.save(path, made.run, checkpoint.read(path).progress, {})
    assert path.read_bytes() == before
    assert not list(tmp_path.glob(".*"))


def test_a_full_disk_leaves_the_old_one(tmp_path, job):
    """A limit on the size of files stands in for a full disk; it reaches what the library writes by itself."""
    train(job(), tmp_path)
    path, size = tmp_path / "last.safetensors", 256
    before = path.read_bytes()
    assert len(before) > size
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        with pytest.raises(SetupError, match="too large"):
            checkpoint.save(
                path, job().run, checkpoint.read(path).progress, {"weights": checkpoint.read(path).tensors("weights")}
            )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, handler)
    assert path.read_bytes() == before
    assert not list(tmp_path.glob(".*"))


def test_other_joints_are_refused_and_both_named(tmp_path, job):
    run = job().run
    checkpoint.check_fits(run, {"joint_names": ("a", "b"), "sizes": {"joints": 2}}, tmp_path)
    with pytest.raises(UsageError, match=r"expected: 2: a, b\n\s+found: 3: a, b, c"):
        checkpoint.check_fits(run, {"joint_names": ("a", "b", "c")}, tmp_path)
    with pytest.raises(UsageError, match=r"expected: joints 2\n\s+found: joints 3"):
        checkpoint.check_fits(run, {"sizes": {"joints": 3}}, tmp_path)


def test_the_average_is_that_of_diffusers():
    from diffusers.training_utils import EMAModel

    layer = torch.nn.Linear(3, 2)
    known = EMAModel(layer.parameters(), power=0.75, use_ema_warmup=True, inv_gamma=1.0)
    ours = ema.start_average(layer.state_dict())
    generator = torch.Generator().manual_seed(0)
    for step in range(30):
        with torch.no_grad():
            for value in layer.parameters():
                value += torch.randn(value.shape, generator=generator)
        known.step(layer.parameters())
        ema.update(ours, layer.state_dict(), step, 0.75)
    for mean, expected in zip(ours.values(), known.shadow_params, strict=True):
        torch.testing.assert_close(mean, expected)


def test_a_log_ends_before_the_first_line_that_is_no_text(tmp_path):
    (tmp_path / steplog.NAME).write_bytes(b'{"step": 1, "loss": 0.5}\n{"step": 2, "loss": NaN}\n{"step": \xff}\n')
    assert [line["step"] for line in steplog.read_log(tmp_path)] == [1, 2]
