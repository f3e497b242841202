"""A small experiment on sets that stand: no simulation, and models of a few steps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from candata.datasets import append, create_dataset, put_cloud
from candata.schema.manifest import Lineage
from tests.training.conftest import gliding

TINY = {"steps": 4, "batch": 8, "config": {"width": 16, "layers": 1}}


def standing_set(folder: Path, name: str, episodes: int, rows: int = 31) -> Path:
    """A set of gliding objects, with a cloud."""
    root = create_dataset(folder / name, name=name)
    cloud = put_cloud(root, np.random.default_rng(0).normal(0, 0.03, (20, 3)).astype(np.float32))
    made = (gliding(f"{name}-{k:02d}", k, rows=rows, point_cloud=cloud) for k in range(episodes))
    append(root, made, Lineage(operation="test"))
    return root


def small_experiment() -> dict:
    """The content of an experiment's file on `sim` and `real` beside it."""
    return {
        "title": "a small table",
        "data": {"sim": {"path": "sim"}, "real": {"path": "real"}},
        "columns": {"single": {"sim": "sim", "real": "real"}},
        "models": {"mlp": TINY},
        "seeds": [0],
        "rows": ["stays"],
        "windows": {"history": 3, "horizon": 4},
        "evaluation": {"samples": 1, "steps": 1},
    }


@pytest.fixture
def experiment_file(tmp_path) -> Callable[..., Path]:
    """Writes an experiment's file beside two sets that stand: `experiment_file(seeds=[0, 1], ...)`."""
    standing_set(tmp_path, "sim", 6)
    standing_set(tmp_path, "real", 10)

    def write(**changes: object) -> Path:
        path = tmp_path / "experiment.yaml"
        path.write_text(yaml.safe_dump(small_experiment() | changes))
        return path

    return write
