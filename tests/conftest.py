"""Shared by all tests: fixed seeds, and the shared recordings where a checkout has them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from candata.schema.episode import Episode, EpisodeMeta

# Two workers on two cores: a thread pool in each would only get in the other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What the person who runs the tests has registered, and which models are known, is none of theirs.
_OWN = Path(tempfile.gettempdir(), f"candata-tests-{os.getpid()}")
os.environ["CANDATA_REGISTRY"] = str(_OWN / "registry.json")
os.environ["XDG_CACHE_HOME"] = str(_OWN / "cache")

settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")

#: Rules that say whether a dataset is whole: what made-up numbers may be is none of theirs.
WHOLE = ("hashes", "schema", "finite")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator with a fixed seed."""
    return np.random.default_rng(20240501)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of shared recordings beside the checkout (or CANDATA_SHARED); skips without it."""
    folder = Path(os.environ.get("CANDATA_SHARED", ROOT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip("no shared recordings beside this checkout")
    return folder


def make_episode(
    name: str, seed: int = 0, rows: int = 20, contact: bool = True, scale: float = 1.0, **meta: object
) -> Episode:
    """A small synthetic episode of a world with two joints and two fingertips."""
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=(rows, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    arrays = {
        "time_ns": np.arange(rows) * 12_500_000,
        "object_pose": np.c_[rng.normal(size=(rows, 3)), quaternion],
        "joint_position": scale * rng.normal(size=(rows, 2)),
        "fingertip_force": rng.normal(size=(rows, 2, 3)),
    }
    if contact:
        arrays["contact"] = np.arange(rows) >= rows // 2
    fields = {"source": "sim", "rate_hz": 80.0, "scene": "s", "joint_names": ("a", "b")} | meta
    return Episode(EpisodeMeta.model_validate({"id": name, **fields}), arrays)


@pytest.fixture
def episode() -> Callable[..., Episode]:
    """Makes small synthetic episodes: `episode(id, seed=..., rows=...)`."""
    return make_episode
