"""Small synthetic episodes for the tests of several rooms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from candata.schema.episode import Episode, EpisodeMeta


def make_episode(
    name: str, seed: int = 0, rows: int = 20, contact: bool = True, scale: float = 1.0, **meta: object
) -> Episode:
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
    return make_episode
