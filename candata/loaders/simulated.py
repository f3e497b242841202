"""Windows with what a simulator made of each: two more entries in their batches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from candata.errors import SetupError
from candata.loaders.feed import Windows
from candata.loaders.mixing import MixedWindows
from candata.loaders.sampling import Sampler


def simulated_keys(object_pose: NDArray, contact: NDArray) -> dict[str, NDArray[np.float32]]:
    """Return the entries of a batch that hold simulated poses `(B, H, 7)` and contacts `(B, H)`."""
    return {
        "simulated/object_pose": np.asarray(object_pose, np.float32),
        "simulated/contact": np.asarray(contact, np.float32),
    }


@dataclass(frozen=True, eq=False)
class SimulatedWindows:
    """Windows whose batches also hold `simulated/object_pose (B, H, 7)` and `simulated/contact (B, H)`, float32.

    Attributes
    ----------
    windows : Windows or MixedWindows
        All else of the batches.
    forecasts : tuple of (n, H, 8) float32
        The simulator's forecasts of the windows of each source.
    """

    windows: Windows | MixedWindows
    forecasts: tuple[NDArray[np.float32], ...]

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.windows)

    @property
    def clouds(self) -> NDArray[np.float32]:
        """Point clouds of the windows."""
        return self.windows.clouds

    def sampler(self, batch_size: int, seed: int = 0, rank: int = 0, world: int = 1) -> Sampler:
        """Return the sampler of the windows."""
        return self.windows.sampler(batch_size, seed, rank, world)

    def batch(self, numbers: ArrayLike) -> dict[str, Any]:
        """Return the windows with these numbers, and what the simulator made of them."""
        index = np.asarray(numbers, np.int64)
        begin = np.cumsum([0, *map(len, self.forecasts)])
        source = begin.searchsorted(index, "right") - 1
        values = np.empty((len(index), *self.forecasts[0].shape[1:]), np.float32)
        for number, forecasts in enumerate(self.forecasts):
            members = source == number
            values[members] = forecasts[index[members] - begin[number]]
        return self.windows.batch(numbers) | simulated_keys(values[..., :7], values[..., 7])

    def resident(self, device: str) -> NoReturn:
        """Refuse: forecasts stay on the host.

        Raises
        ------
        SetupError
            Always.
        """
        raise SetupError("the simulator's forecasts are kept on the host", found=device)
