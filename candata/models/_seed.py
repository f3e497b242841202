"""First weights from an explicit seed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import torch

T = TypeVar("T")


def with_seed(seed: int, make: Callable[[], T]) -> T:
    """Return what `make` makes with torch's generator at `seed`; the generator's own state is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return make()
