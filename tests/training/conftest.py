"""A model of one layer and its data: enough for a loop."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from candata.training.loop import Job
from candata.training.settings import Run, Settings


class Line(torch.nn.Module):
    """Forecasts increments as a linear function of the joints, in noise."""

    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(2, 6)
        self.register_buffer("scale", torch.tensor(2.0))

    def losses(self, batch, generator):
        truth = batch["future/increments"]
        noise = 0.01 * torch.randn(truth.shape, generator=generator, device=truth.device)
        error = self.layer(batch["history/joint_position"] * self.scale) - truth - noise
        return {"loss": (error**2).mean(), "rotation": (error[:, 3:] ** 2).mean()}


def make_batch(step: int, seed: int = 0) -> dict[str, torch.Tensor]:
    rng = np.random.default_rng([seed, step])
    joints = rng.normal(size=(8, 2)).astype(np.float32)
    truth = joints @ np.arange(12, dtype=np.float32).reshape(2, 6) / 6
    return {"history/joint_position": torch.from_numpy(joints), "future/increments": torch.from_numpy(truth)}


def make_run(**changes: object) -> Run:
    settings = {"steps": 60, "batch": 8, "learning_rate": 1e-2, "warm_up": 5, "validate_every": 20, "log_every": 5}
    return Run(
        model="line", config={"width": 2}, sizes={"joints": 2}, joint_names=("a", "b"), dataset="d", digest="0" * 64,
        version=1, split="default", split_digest="0", rate_hz=10.0, channels=("joint_position",),
        units={"joint_position": "joint"}, normaliser={},
        settings=Settings.model_validate(settings | changes), revision="0",
    )  # fmt: skip


def make_job(draw=make_batch, **changes: object) -> Job:
    run = make_run(**changes)
    with torch.random.fork_rng():
        torch.manual_seed(run.settings.seed)
        module = Line()
    return Job(run, module, draw, (make_batch(0, seed=1), make_batch(1, seed=1)))


@pytest.fixture
def job():
    """Makes small jobs: `job(steps=..., draw=...)`."""
    return make_job


@pytest.fixture
def batch():
    """Makes the batch of a step."""
    return make_batch
