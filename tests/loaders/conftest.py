"""Small datasets in which every value says where it comes from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from candata.datasets import Dataset, append, create_dataset, open_dataset
from candata.rotation import exp
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage


def make(name: str, rows: int = 30, offset: float = 0.0, arrays: Mapping | None = None, **meta) -> Episode:
    """An episode of two joints and one fingertip; every number grows with the row."""
    row = np.arange(rows) + offset
    turn = exp(0.01 * row[:, None] * np.array([0.0, 0.0, 1.0]))
    channels = {
        "time_ns": np.arange(rows) * 12_500_000,
        "object_pose": np.c_[row * 0.01, row * 0.0, row * 0.0 + 1, turn],
        "joint_position": np.c_[row, -row],
        "action": np.c_[row + 0.5, -row - 0.5],
        "fingertip_force": (row[:, None, None] * np.array([0.0, 0.0, 1.0])).reshape(rows, 1, 3),
        "contact": np.arange(rows) % 3 == 0,
    }
    fields = {"source": "sim", "rate_hz": 80.0, "joint_names": ("a", "b"), "fingertip_names": ("tip",)} | meta
    chosen = {k: v for k, v in {**channels, **(arrays or {})}.items() if v is not None}
    return Episode(EpisodeMeta.model_validate({"id": name, **fields}), chosen)


@pytest.fixture(scope="session")
def hand() -> Callable[..., Episode]:
    """Makes an episode: `hand(id, rows=..., offset=..., arrays={channel: values or None}, **meta)`."""
    return make


@pytest.fixture
def store(tmp_path: Path) -> Callable[..., Dataset]:
    """Keeps episodes in a new dataset: `store(episode, ...)`."""

    def keep(*episodes: Episode, name: str = "ds") -> Dataset:
        root = create_dataset(tmp_path / name, exist_ok=True)
        append(root, episodes, Lineage(operation="test"))
        return open_dataset(root)

    return keep
