"""Batches on their device: from windows to tensors, the same for the same seed and step."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from candata.loaders import Sampler, Windows, as_tensors
from candata.models import Batch


def tensors(batch: Mapping[str, NDArray], clouds: torch.Tensor, device: str) -> dict[str, torch.Tensor]:
    """Return a batch of windows as tensors on the device, with the point clouds that `cloud` points into."""
    moved = {name: value.to(device) for name, value in as_tensors(batch).items()}
    return moved | {"clouds": clouds}


def clouds_of(windows: Windows, device: str) -> torch.Tensor:
    """Return the windows' distinct point clouds `(C, N, 3)` on the device."""
    return torch.from_numpy(windows.clouds).to(device)


def drawing(windows: Windows, seed: int, batch: int, device: str) -> Callable[[int], Batch]:
    """Return the function from step to batch; without replacement within an epoch."""
    sampler, clouds = Sampler(len(windows), batch, seed), clouds_of(windows, device)
    return lambda step: tensors(windows.batch(sampler.indices(step)), clouds, device)


def held_out(windows: Windows, batch: int, batches: int, device: str) -> tuple[Batch, ...]:
    """Return up to `batches` batches, spread evenly over the windows, always the same."""
    count = min(len(windows), batch * batches)
    numbers = np.linspace(0, len(windows) - 1, count).round().astype(np.int64)
    clouds = clouds_of(windows, device)
    return tuple(
        tensors(windows.batch(numbers[first : first + batch]), clouds, device) for first in range(0, count, batch)
    )
