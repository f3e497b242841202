"""Windows per core-second, beside an item-by-item Dataset in the same run, and what opening the cache costs.

    python benchmarks/windows.py

300 episodes of 300 steps (pose 7, joints 19, actions 19, forces 5 x 3 float32, contact 5 bool), windows of 20 rows
(10 + 10), batches of 256 in random order. Rounds take turns, so that a busy machine slows all alike; time is the
process's CPU time on one thread. Needs the extra `train`.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from candata.datasets import append, create_dataset, open_dataset
from candata.loaders import Windows, as_tensors, windows
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

JOINTS, FINGERTIPS, BATCH = 19, 5, 256
LOADER_TARGET, DIRECT_TARGET, OPEN_TARGET_S = 250_000, 500_000, 0.1


def episodes(count: int, rows: int) -> Iterable[Episode]:
    """Yield synthetic episodes with the channels of a hand."""
    rng = np.random.default_rng(0)
    for number in range(count):
        quaternion = rng.normal(size=(rows, 4))
        arrays = {
            "time_ns": np.arange(rows) * 12_500_000,
            "object_pose": np.c_[rng.normal(size=(rows, 3)), quaternion / np.linalg.norm(quaternion, axis=1)[:, None]],
            "joint_position": rng.normal(size=(rows, JOINTS)),
            "action": rng.normal(size=(rows, JOINTS)),
            "fingertip_force": rng.normal(size=(rows, FINGERTIPS, 3)),
            "fingertip_contact": rng.random((rows, FINGERTIPS)) < 0.5,
        }
        yield Episode(EpisodeMeta(id=f"e{number:04d}", source="sim", rate_hz=80), arrays)


class ItemByItem(Dataset):
    """The plain way: arrays in memory, one window sliced at a time, batches stacked by torch."""

    def __init__(self, source: Iterable[Episode], history: int, horizon: int):
        """Hold the arrays and the list of windows."""
        self.arrays: list[Mapping[str, np.ndarray]] = [
            {name: values for name, values in episode.arrays.items() if name != "time_ns"} for episode in source
        ]
        self.history, self.horizon = history, horizon
        lengths = [len(arrays["action"]) for arrays in self.arrays]
        self.places = [(e, t) for e, n in enumerate(lengths) for t in range(history - 1, n - horizon)]

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.places)

    def __getitem__(self, number: int) -> dict[str, torch.Tensor]:
        """Return one window."""
        episode, row = self.places[number]
        first, behind = row - self.history + 1, row + self.horizon + 1
        return {n: torch.from_numpy(v[first:behind].copy()) for n, v in self.arrays[episode].items()}


def through_loader(dataset: Dataset, collate, batches: int) -> float:
    """Return windows per CPU second of a DataLoader without workers."""
    order = torch.randperm(len(dataset), generator=torch.Generator().manual_seed(0))[: batches * BATCH].tolist()
    loader = DataLoader(dataset, batch_size=BATCH, sampler=order, collate_fn=collate)
    begin = time.process_time()
    seen = sum(BATCH for _ in loader)
    return seen / (time.process_time() - begin)


def direct(feed: Windows, batches: int) -> float:
    """Return windows per CPU second of `Windows.batch` in the order of a Sampler."""
    sampler = feed.sampler(BATCH)
    sampler.indices(0)
    begin = time.process_time()
    for step in range(batches):
        feed.batch(sampler.indices(step))
    return batches * BATCH / (time.process_time() - begin)


def main() -> None:
    """Print each figure beside its target."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--rows", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=7)
    args = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        root = create_dataset(Path(folder) / "ds")
        append(root, episodes(args.episodes, args.rows), Lineage(operation="benchmark"))
        dataset = open_dataset(root)
        shape = {"history": 10, "horizon": 10, "stride": 1, "pad": "none"}
        begin = time.process_time()
        windows(dataset, **shape)
        print(f"making the cache: {time.process_time() - begin:.2f} CPU s")
        opened, results = [], {"item by item": [], "DataLoader": [], "direct": []}
        plain = ItemByItem(dataset, 10, 10)
        for _ in range(args.rounds):
            begin = time.process_time()
            feed = windows(dataset, **shape)
            opened.append(time.process_time() - begin)
            results["item by item"].append(through_loader(plain, None, 20))
            results["DataLoader"].append(through_loader(feed, as_tensors, len(feed) // BATCH))
            results["direct"].append(direct(feed, len(feed) // BATCH))
    middle = {name: float(np.median(values)) for name, values in results.items()}
    print(f"open: {np.median(opened):.3f} CPU s (target < {OPEN_TARGET_S})")
    print(f"item by item, DataLoader: {middle['item by item']:,.0f} windows per core-second")
    for name, target in (("DataLoader", LOADER_TARGET), ("direct", DIRECT_TARGET)):
        print(
            f"windows, {name}: {middle[name]:,.0f} windows per core-second (target >= {target:,}), "
            f"{middle[name] / middle['item by item']:.0f} x item by item"
        )


if __name__ == "__main__":
    main()
