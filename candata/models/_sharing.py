"""A batch that several processes share: each holds its rows, and draws and counts as one process with all would."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Share:
    """Which rows of a batch this process holds.

    Attributes
    ----------
    rank, world : int
        Number of this process, and how many there are; each holds equally many rows, one behind the other.
    total : callable
        A tensor to its sum over all processes.
    """

    rank: int
    world: int
    total: Callable[[Tensor], Tensor]


_SHARE: ContextVar[Share | None] = ContextVar("share", default=None)


@contextmanager
def sharing(share: Share) -> Iterator[None]:
    """Let the losses that are computed meanwhile be a share: their mean over all processes is that of the batch."""
    token = _SHARE.set(share)
    try:
        yield
    finally:
        _SHARE.reset(token)


def draw_rows(draw: Callable[[tuple[int, ...]], Tensor], shape: tuple[int, ...]) -> Tensor:
    """Return what `draw` draws for the rows that this process holds, `shape[0]` of them; those of all are drawn."""
    share = _SHARE.get()
    if share is None:
        return draw(shape)
    rows = shape[0]
    return draw((share.world * rows, *shape[1:]))[share.rank * rows : (share.rank + 1) * rows]


def mean_count(count: Tensor) -> Tensor:
    """Return what a sum over `count` values is divided by, at least 1: in a share, the mean count of all processes."""
    share = _SHARE.get()
    return count.clamp_min(1) if share is None else share.total(count).clamp_min(1) / share.world
