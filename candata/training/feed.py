"""Batches on their device: from windows to tensors, the same for the same seed and step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from candata.errors import SetupError
from candata.loaders import Gather, MixedWindows, SimulatedWindows, Windows, as_tensors, augment, noise
from candata.models import Batch
from candata.training.processes import ALONE, Processes
from candata.training.settings import TrainingSettings

#: What batches may come from.
AnyWindows = Windows | MixedWindows | SimulatedWindows


def tensors(batch: Mapping[str, NDArray], clouds: torch.Tensor, device: str) -> dict[str, torch.Tensor]:
    """Return a batch of windows as tensors on the device, with the point clouds that `cloud` points into."""
    device_tensors = {name: value.to(device) for name, value in as_tensors(batch).items()}
    return device_tensors | {"clouds": clouds}


def clouds_of(windows: AnyWindows, device: str) -> torch.Tensor:
    """Return the windows' distinct point clouds `(C, N, 3)` on the device."""
    return torch.from_numpy(windows.clouds).to(device)


def drawing(
    windows: AnyWindows, settings: TrainingSettings, device: str, processes: Processes = ALONE
) -> Callable[[int], Batch]:
    """Return the function from step to batch; without replacement within an epoch, with the settings' noise.

    On a GPU the rows are resident there, where they fit. Of several processes each takes its rows of the batch.

    Raises
    ------
    UsageError
        When the batch does not divide among the processes.
    """
    rows, clouds = processes.rows(settings.batch), clouds_of(windows, device)
    sampler = windows.sampler(rows, settings.seed, processes.rank, processes.world)
    source = _source(windows, device)

    def draw(step: int) -> Batch:
        batch = source.batch(sampler.indices(step))
        if not settings.augment.is_off:
            batch = augment(batch, settings.augment, _Normals(noise(settings.seed, step), processes))
        return batch | {"clouds": clouds} if isinstance(source, Gather) else tensors(batch, clouds, device)

    return draw


@dataclass(frozen=True)
class _Normals:
    """Draws noise for the rows of all processes, and gives those of this one."""

    rng: np.random.Generator
    processes: Processes

    def standard_normal(self, size: tuple[int, ...], dtype: type[np.floating] = np.float64) -> NDArray:
        """Return `size` numbers, the first axis being the rows."""
        rows, first = size[0], size[0] * self.processes.rank
        whole = self.rng.standard_normal((rows * self.processes.world, *size[1:]), dtype)  # type: ignore[arg-type]
        return whole[first : first + rows]


def held_out(windows: AnyWindows, batch: int, batches: int, device: str) -> tuple[Batch, ...]:
    """Return up to `batches` batches, spread evenly over the windows, or drawn in a mixture's shares; always the same.

    They have no noise.
    """
    count = min(len(windows), batch * batches)
    if isinstance(windows.windows if isinstance(windows, SimulatedWindows) else windows, MixedWindows):
        numbers = windows.sampler(count).indices(0)
    else:
        numbers = np.linspace(0, len(windows) - 1, count).round().astype(np.int64)
    clouds = clouds_of(windows, device)
    return tuple(
        tensors(windows.batch(numbers[begin : begin + batch]), clouds, device) for begin in range(0, count, batch)
    )


def _source(windows: AnyWindows, device: str) -> AnyWindows | Gather:
    """Return where batches are gathered: on the GPU, where the rows fit, else on the host."""
    if device == "cpu":
        return windows
    try:
        return windows.resident(device)
    except SetupError:
        return windows
