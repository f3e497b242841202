"""Time of worlds that keep another: rows that last longer than nominal, and physics steps of another length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.scenes import Scene
from candata.simulate.world import Worlds

Array = NDArray[np.float64]


def steps_of(scene: Scene, worlds: Worlds) -> NDArray[np.int64]:
    """Return `(n,)` physics steps of one recorded row in each world."""
    steps = np.array([model.opt.timestep for model in worlds.models])
    return np.maximum(1, np.round(worlds.pace / scene.file.rate_hz / steps)).astype(int)


def retime_commands(commands: Array, pace: Array, substeps: int, settle: int) -> Array:
    """Return commands `(n, T, S, A)` at S steps a row, where a row lasts `pace (n,)` rows of the commands.

    Rows before `settle` last one. Each step gets the mean of the held command over its time; after the last command
    that one is held.
    """
    count = commands.shape[1]
    edges = np.arange(count * substeps + 1) / substeps
    zero_sum = np.zeros((len(commands), 1, commands.shape[2]))
    total = np.concatenate([zero_sum, np.cumsum(commands, axis=1)], axis=1)
    out = np.empty((len(commands), count * substeps, commands.shape[2]))
    for i, speed in enumerate(pace):
        at = np.where(edges <= settle, edges, settle + (edges - settle) * speed)
        row = np.minimum(at.astype(int), count - 1)
        sums = total[i, row] + (at - row)[:, None] * commands[i, row]
        out[i] = np.diff(sums, axis=0) / np.diff(at)[:, None]
    return out.reshape(len(commands), count, substeps, commands.shape[2])


def resample_control(control: Array, steps: int) -> Array:
    """Return `(n, steps, nu)` controls of one row given at S steps: the mean over each new step."""
    count = control.shape[1]
    if steps == count:
        return control
    total = np.concatenate([np.zeros_like(control[:, :1]), np.cumsum(control, axis=1)], axis=1)
    at = np.arange(steps + 1) * count / steps
    row = np.minimum(at.astype(int), count - 1)
    sums = total[:, row] + (at - row)[None, :, None] * control[:, row]
    return np.diff(sums, axis=1) * steps / count
