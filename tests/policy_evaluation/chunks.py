"""Chunks and worlds made by hand: what is forecast of them is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candata.policy_evaluation.chunk_worlds import ChunkForecast
from candata.policy_evaluation.commands import CommandBounds

RATE_HZ = 10.0
BOUNDS = CommandBounds(
    ("lift", "grip"), np.array([[-1.0, 1.0], [-1.0, 1.0]]), np.array([0.2, 0.2]), np.array([0.3, 0.3]), RATE_HZ
)


def poses_of(height: np.ndarray) -> np.ndarray:
    """Poses `(..., T, 7)` of an upright object at heights `(..., T)` [m]."""
    poses = np.zeros((*height.shape, 7))
    poses[..., 2], poses[..., 3] = height, 1.0
    return poses


@dataclass
class LiftingWorld:
    """The object rises by a tenth of the `lift` command [m]; samples differ by `spread_m`; far commands are strange."""

    spread_m: float = 0.0
    familiar_up_to: float = np.inf
    works: bool = True
    name: str = "a lift by hand"

    def forecast(self, commands: np.ndarray, seed: tuple[int, ...]) -> ChunkForecast:
        height = 0.1 * commands[..., 0] * self.works
        height = np.concatenate([np.zeros_like(height[..., :1]), height], axis=-1)
        noise = self.spread_m * np.random.default_rng(seed).standard_normal((8, *height.shape[:-1], 1))
        noise = np.concatenate([np.zeros_like(noise), np.repeat(noise, commands.shape[2], axis=-1)], axis=-1)
        return ChunkForecast(poses_of(height + noise), np.ones(commands.shape[:3]), RATE_HZ)

    def is_familiar(self, commands: np.ndarray) -> np.ndarray:
        return (np.abs(commands) <= self.familiar_up_to).all((-1, -2))
