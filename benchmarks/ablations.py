"""What each input of the models is worth: closed-loop ADD-S AUC with a changed field less that of the preset.

    OMP_NUM_THREADS=1 python benchmarks/ablations.py --model mlp --steps 3000 --seeds 1 2

Simulates episodes of `xhand_tabletop`, or takes `--data`. Trains the preset `small` on two thirds of them, with each
field changed alone, and follows the other third in closed loop. Differences are paired by episode and averaged over the
seeds; the interval resamples episodes. `mean of the seeds' nets` is one forecaster made of all nets of the preset.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset, open_dataset
from candata.loaders import Windows, make_split, save_split, windows
from candata.models import model as find_model
from candata.simulate.generate import generate
from candata.statistics import resamples
from candata.training import checkpoint, feed, jobs, metrics
from candata.training.data import channels_for
from candata.training.forecasters import Batch, ForecastArrays, TrainedModel
from candata.training.jobs import TrainRequest, prepare
from candata.training.loop import train
from candata.training.rollout import Course, close_loop, course
from candata.training.settings import TrainingSettings

#: What a line says to the fields that differ from the preset.
LINES: dict[str, dict[str, Any]] = {
    "without planned actions": {"planned_actions": False},
    "without the world position": {"world_position": False},
    "without fingertip points": {"fingertip_points": False},
    "with fingertip points": {"fingertip_points": True},
    "with contact of hand and fingertips": {"contact_history": True, "fingertip_contact": True},
}
SPLIT, TRAIN_SHARE, RESAMPLES, EXECUTE, SAMPLES, SAMPLING_STEPS = "ablations", 2 / 3, 4000, 8, 4, 4


@dataclass(frozen=True)
class Nets:
    """Several nets as one forecaster: the samples of all."""

    members: tuple[TrainedModel, ...]
    summary: str = "several nets"

    def forecast(self, batch: Batch, seed: tuple[int, ...]) -> ForecastArrays:
        """Return the samples of all nets, and the mean of their contacts."""
        forecasts = [member.forecast(batch, seed) for member in self.members]
        contacts = [each.contact for each in forecasts if each.contact is not None]
        increments = np.concatenate([each.increments for each in forecasts])
        return ForecastArrays(increments, np.mean(contacts, axis=0) if contacts else None)


@dataclass(frozen=True)
class Ablation:
    """A dataset whose held-out episodes are followed by nets trained on the others."""

    dataset: Dataset
    held_out: Windows
    course: Course
    model: str
    steps: int
    scratch: Path

    def net(self, fields: dict[str, Any], seed: int) -> TrainedModel:
        """Return a trained net of the preset `small` with some fields changed."""
        settings = TrainingSettings(seed=seed, steps=self.steps, learning_rate=5e-4, warm_up=100)
        job = prepare(self.dataset, TrainRequest(self.model, "small", fields, split=SPLIT), settings)
        folder = self.scratch / f"run-{len(list(self.scratch.glob('run-*')))}"
        train(job, folder)
        module = jobs.trained_module(checkpoint.read(folder))
        return TrainedModel(module, feed.clouds_of(self.held_out, "cpu"), SAMPLES, SAMPLING_STEPS)

    def accuracy(self, forecaster: Any) -> NDArray:
        """Return each episode's sum over its rows of the part under the accuracy curve, `(E,)`."""
        poses = close_loop(self.course, forecaster, EXECUTE, 0).poses
        adds = metrics.adds_of(self.held_out.clouds, self.course.cloud, poses, self.course.truth)
        below: NDArray = np.where(self.course.valid, np.maximum(0.0, 1 - adds / metrics.ADDS_LIMIT_M), 0.0).sum(1)
        return below


def ablation(dataset: Dataset, args: argparse.Namespace, scratch: Path) -> Ablation:
    """Return the ablation of a dataset; its split is kept there."""
    ids = np.random.default_rng(0).permutation(sorted(dataset.ids)).tolist()
    count = round(TRAIN_SHARE * len(ids))
    groups = {"train": tuple(sorted(ids[:count])), "val": (), "test": tuple(sorted(ids[count:]))}
    save_split(dataset, make_split(dataset).model_copy(update=groups), SPLIT)
    channels = channels_for(("object_pose", "joint_position", "action", "contact", "fingertip_contact"), dataset)
    held_out = windows(dataset, channels=channels, splits=SPLIT, split="test", pad="both")
    return Ablation(dataset, held_out, course(held_out), args.model, args.steps, scratch)


def line(name: str, differences: Sequence[NDArray], counts: NDArray) -> None:
    """Print the mean difference in points with its interval over episodes."""
    difference = np.mean(differences, axis=0)
    picks = resamples(np.random.default_rng(0), len(counts), RESAMPLES)
    low, high = np.quantile(difference[picks].sum(1) / counts[picks].sum(1), (0.025, 0.975))
    value = difference.sum() / counts.sum()
    print(f"{name:<40}{100 * value:+6.2f} points (95 % {100 * low:+.2f} to {100 * high:+.2f})", flush=True)


def report(study: Ablation, seeds: Sequence[int]) -> None:
    """Print a line for each field."""
    counts = study.course.valid.sum(1)
    nets = [study.net({}, seed) for seed in seeds]
    preset = [study.accuracy(net) for net in nets]
    auc = 100 * np.mean(preset, axis=0).sum() / counts.sum()
    print(f"{study.model} small, {study.steps} steps: {auc:.2f} % on {len(counts)} episodes, {len(seeds)} seeds")
    small = find_model(study.model).presets["small"].model_dump()
    for name, fields in LINES.items():
        if all(small[key] == value for key, value in fields.items()):
            continue  # the preset says so already
        changed = [study.accuracy(study.net(fields, seed)) for seed in seeds]
        line(name, [after - before for after, before in zip(changed, preset, strict=True)], counts)
    if len(nets) > 1:
        together = study.accuracy(Nets(tuple(nets)))
        line("mean of the seeds' nets", [together - before for before in preset], counts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="dataset with clouds; simulated when left out")
    parser.add_argument("--episodes", type=int, default=260)
    parser.add_argument("--model", default="mlp")
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        data = args.data or Path(scratch) / "data"
        if args.data is None:
            generate(data, "xhand_tabletop", args.episodes, 6202)
        report(ablation(open_dataset(data), args, Path(scratch)), args.seeds)


if __name__ == "__main__":
    main()
