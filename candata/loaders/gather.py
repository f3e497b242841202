"""The gather: from numbers of windows to a batch, the same code for numpy arrays and for torch tensors on a device."""

from __future__ import annotations

from collections.abc import Callable, Iterator, KeysView, Mapping, Sequence
from dataclasses import dataclass
from itertools import count as count_from
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from candata.loaders.sampling import Sampler

#: A numpy array or a torch tensor; one gather holds one kind.
Array = Any
Batch = dict[str, Array]


@dataclass(frozen=True, eq=False, repr=False)
class WindowList(Sequence[Batch]):
    """Windows of one gathered batch: a sequence of windows, and by the name of an entry the whole batch's.

    PyTorch's default collate takes its windows, each without the first axis; `dict` and `as_tensors` take the batch.

    Attributes
    ----------
    whole : dict of str to array
        The batch, see `Windows.batch`.
    """

    whole: Batch

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(next(iter(self.whole.values())))

    def __getitem__(self, key: Any) -> Any:
        """Return a window by its number, or an entry of the whole batch by its name."""
        if isinstance(key, str):
            return self.whole[key]
        return {name: values[key] for name, values in self.whole.items()}

    def __iter__(self) -> Iterator[Batch]:
        """Yield the windows."""
        return (self[number] for number in range(len(self)))

    def keys(self) -> KeysView[str]:
        """Return the names of the batch's entries."""
        return self.whole.keys()


class Feed(Protocol):
    """A source of batches: windows, a mixture of them, or the resident copy of either."""

    def batch(self, numbers: ArrayLike) -> Batch:
        """Return the windows with these numbers."""
        ...


@dataclass(frozen=True, eq=False)
class Gather:
    """The place of each window, and how its rows are taken.

    Attributes
    ----------
    channels : tuple of str
        Channels of a row.
    history : int
        Rows of the past, the present one included.
    steps : (W,) int64
        Steps from the present, the oldest first.
    present_row, owner : (n,) int64
        Row of the present and number of the episode, by window.
    begin, last_row, stride : (E,) int64
        First and last row, and native rows a step, by episode.
    columns : mapping of str to (E,) int64
        What a batch says of each window's episode beside its number.
    valid : (R,) bool or None
        Rows that hold a value of every channel; None where all do.
    stretch : (R,) int32 or None
        Equal for rows without a break between; None where there is no break.
    index : callable
        From the numbers that are asked for to an index of this kind of array.
    take : callable
        From rows `(B, W)` to what gives `(B, W, ...)` of a channel by its name.
    """

    channels: tuple[str, ...]
    history: int
    steps: Array
    present_row: Array
    owner: Array
    begin: Array
    last_row: Array
    stride: Array
    columns: Mapping[str, Array]
    valid: Array | None
    stretch: Array | None
    index: Callable[[ArrayLike], Array]
    take: Callable[[Array], Any]

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.present_row)

    def batch(self, numbers: ArrayLike) -> Batch:
        """Return the windows with these numbers; see `Windows.batch`."""
        index = self.index(numbers)
        owner, present_row = self.owner[index], self.present_row[index]
        begin = self.begin[owner]
        target_rows = present_row[:, None] + self.steps * self.stride[owner][:, None]
        rows = target_rows.clip(begin[:, None], self.last_row[owner][:, None])
        pad = rows != target_rows
        if self.valid is not None:
            pad = pad | ~self.valid[rows]
        if self.stretch is not None:
            pad = pad | (self.stretch[rows] != self.stretch[present_row][:, None])
        out = self._split_channels(self.take(rows))
        out["history_pad"], out["future_pad"] = pad[:, : self.history], pad[:, self.history :]
        out |= {name: values[owner] for name, values in self.columns.items()}
        out["episode"], out["row"] = owner, present_row - begin
        return out

    def _split_channels(self, block: Any) -> Batch:
        """Return past, future and plan of each channel."""
        out: Batch = {}
        for name in self.channels:
            values = block[name]
            out[f"history/{name}"], out[f"future/{name}"] = values[:, : self.history], values[:, self.history :]
            if name == "action":
                out["planned/action"] = values[:, self.history - 1 : -1]
        return out


def host_index(numbers: ArrayLike) -> NDArray[np.int64]:
    """Return the numbers as an index of numpy arrays."""
    return np.asarray(numbers, np.int64)


@dataclass(frozen=True, eq=False)
class OneStore:
    """Takes rows of one structured array."""

    rows: NDArray

    def __call__(self, row_ids: NDArray[np.int64]) -> NDArray:
        """Return `(B, W) structured`."""
        # mode="clip" skips a buffered check; the rows are within the episodes by construction.
        return self.rows.take(row_ids, mode="clip")


@dataclass(frozen=True, eq=False)
class Stores:
    """Takes rows of several structured arrays of one dtype, as if they stood one behind the other."""

    rows: tuple[NDArray, ...]

    def __call__(self, row_ids: NDArray[np.int64]) -> NDArray:
        """Return `(B, W) structured`; the rows of one window are of one array."""
        row = self.rows[0].dtype
        # As plain bytes: numpy would copy a structured row field by field.
        block, offset = np.empty(row_ids.shape, f"V{row.itemsize}"), 0
        for rows in self.rows:
            window_ids = np.flatnonzero((row_ids[:, 0] >= offset) & (row_ids[:, 0] < offset + len(rows)))
            block[window_ids] = rows.view(block.dtype).take(row_ids[window_ids] - offset, mode="clip")
            offset += len(rows)
        return block.view(row)


def batches(feed: Feed, sampler: Sampler, first_step: int = 0) -> Iterator[Batch]:
    """Yield the batches of all steps from `first_step` on, without end: the direct path, without a DataLoader.

    Parameters
    ----------
    feed : Feed
        Windows, a mixture, or the resident copy of either.
    sampler : Sampler
        Which windows a step takes: `feed.sampler(...)`.
    first_step : int
        Step to begin at; a run that goes on begins where it stopped.
    """
    return (feed.batch(sampler.indices(step)) for step in count_from(first_step))
