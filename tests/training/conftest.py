"""A model of one layer and its data: enough for a loop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from candata.datasets import Dataset, append, create_dataset, open_dataset, put_cloud
from candata.rotation import exp
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from candata.simulate.generate import generate
from candata.training.loop import TrainingJob
from candata.training.settings import Run, TrainingSettings


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
        model="line",
        config={"width": 2},
        sizes={"joints": 2},
        joint_names=("a", "b"),
        dataset="d",
        digest="0" * 64,
        version=1,
        split="default",
        split_digest="0",
        rate_hz=10.0,
        channels=("joint_position",),
        units={"joint_position": "joint"},
        normaliser={},
        settings=TrainingSettings.model_validate(settings | changes),
        revision="0",
    )


def make_job(draw=make_batch, **changes: object) -> TrainingJob:
    run = make_run(**changes)
    with torch.random.fork_rng():
        torch.manual_seed(run.settings.seed)
        module = Line()
    return TrainingJob(run, module, draw, (make_batch(0, seed=1), make_batch(1, seed=1)))


@pytest.fixture
def job():
    """Makes small jobs: `job(steps=..., draw=...)`."""
    return make_job


@pytest.fixture
def batch():
    """Makes the batch of a step."""
    return make_batch


RATE_HZ = 20.0
VELOCITY_M_S, TURN_RAD_S = np.array([0.05, -0.02, 0.01]), np.array([0.0, 0.0, 0.4])


def gliding(name: str, seed: int, rows: int = 61, contact: bool = True, **meta: object) -> Episode:
    """An object that glides and turns at constant rates; the hand touches in the second half."""
    rng, time_s = np.random.default_rng(seed), np.arange(rows) / RATE_HZ
    pose = np.concatenate(
        [rng.normal(0, 0.1, 3) + time_s[:, None] * VELOCITY_M_S, exp(time_s[:, None] * TURN_RAD_S)], 1
    )
    arrays = {
        "time_ns": np.arange(rows) * round(1e9 / RATE_HZ),
        "object_pose": pose,
        "joint_position": rng.normal(size=(rows, 2)),
        "action": rng.normal(size=(rows, 2)),
    }
    if contact:
        arrays["contact"] = np.arange(rows) >= rows // 2
    fields = {"source": "sim", "rate_hz": RATE_HZ, "joint_names": ("a", "b"), "actuator_names": ("a", "b")}
    return Episode(EpisodeMeta.model_validate({"id": name, **fields, **meta}), arrays)


@pytest.fixture
def dataset(tmp_path) -> Callable[..., Dataset]:
    """Makes datasets of gliding objects: `dataset(name, episodes=..., rows=..., cloud=...)`."""

    def make(name: str = "glide", episodes: int = 10, rows: int = 61, cloud: bool = True, **more: object) -> Dataset:
        folder: Path = create_dataset(tmp_path / name, name=name)
        points = np.random.default_rng(0).normal(0, 0.03, (40, 3)).astype(np.float32)
        if cloud:
            more["point_cloud"] = put_cloud(folder, points)
        made = (gliding(f"{name}-{k:02d}", k, rows=rows + 2 * k, **more) for k in range(episodes))
        append(folder, made, Lineage(operation="test"))
        return open_dataset(folder)

    return make


@pytest.fixture(scope="session")
def nominal(tmp_path_factory) -> Path:
    """Episodes of a gripper in its own scene, without sensor noise."""
    folder = tmp_path_factory.mktemp("nominal") / "data"
    generate(folder, "gripper_tabletop", 3, 1, workers=1, noise=False, duration_s=1.6)
    return folder


@pytest.fixture
def rewritten() -> Callable[..., Dataset]:
    """Makes a dataset of the same episodes with some arrays or facts changed: `rewritten(folder, source, change)`."""

    def make(folder: Path, source: Path, change: Callable[[Episode], dict], **meta: object) -> Dataset:
        root, changed = create_dataset(folder), {"point_cloud": None, **meta}
        episodes = [
            Episode(episode.meta.model_copy(update=changed), dict(episode.arrays) | change(episode))
            for episode in open_dataset(source).episodes()
        ]
        append(root, episodes, Lineage(operation="test"))
        return open_dataset(root)

    return make
