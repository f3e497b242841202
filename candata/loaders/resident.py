"""The resident feed: rows moved once to a device, windows gathered there. Needs the extra `train`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from candata.errors import MissingExtraError, SetupError
from candata.loaders.gather import Gather

if TYPE_CHECKING:
    import torch

#: Share of a GPU's free memory that resident rows may take; the rest is for the model. Chosen.
SHARE_OF_FREE = 0.5

_WORD = np.dtype(np.int64)


def move(gather: Gather, stores: Sequence[NDArray], device: str) -> Gather:
    """Return a gather whose arrays are tensors on the device; batches are equal to those of the host, bit for bit.

    Parameters
    ----------
    gather : Gather
        The gather of the host.
    stores : sequence of (R,) structured
        Its rows, one array behind the other.
    device : str
        `cpu`, `cuda` or another of torch's.

    Raises
    ------
    MissingExtraError
        When torch is not installed.
    SetupError
        When the rows do not fit in half of what is free on the GPU.
    """
    torch = _torch()
    needed_bytes = sum(rows.nbytes for rows in stores)
    free = free_bytes(device)
    if free is not None and needed_bytes > SHARE_OF_FREE * free:
        raise SetupError(
            f"the rows do not fit on {device}",
            expected=f"at most half of what is free there, {SHARE_OF_FREE * free / 1e9:.1f} GB",
            found=f"{needed_bytes / 1e9:.1f} GB",
            fix="hold fewer channels, or gather on the host: windows.batch",
        )
    words = torch.cat([torch.from_numpy(_words(rows)).to(device) for rows in stores])

    def to_device(values: NDArray) -> Any:
        return torch.from_numpy(np.array(values)).to(device)

    return replace(
        gather,
        **{
            name: to_device(getattr(gather, name))
            for name in ("steps", "present_row", "owner", "begin", "last_row", "stride")
        },
        columns={name: to_device(values) for name, values in gather.columns.items()},
        valid=None if gather.valid is None else to_device(gather.valid),
        stretch=None if gather.stretch is None else to_device(gather.stretch),
        index=_index(len(gather), device),
        take=_Words(words, _fields(stores[0].dtype)),
    )


def free_bytes(device: str) -> int | None:
    """Return the free memory of a GPU [bytes]; None for other devices."""
    if not device.startswith("cuda"):
        return None
    free: int = _torch().cuda.mem_get_info(device)[0]
    return free


@dataclass(frozen=True, eq=False)
class _Words:
    """Takes rows of a tensor `(R, words) int64` and reads the channels out of them."""

    words: torch.Tensor
    layout: Mapping[str, tuple[int, int, Any, tuple[int, ...]]]

    def __call__(self, rows: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return channel to `(B, W, ...)`, views of one block."""
        block = self.words.index_select(0, rows.reshape(-1)).view(_torch().uint8)
        count, width = rows.shape
        return {
            name: block[:, start:stop].view(kind).view(count, width, *shape)
            for name, (start, stop, kind, shape) in self.layout.items()
        }


def _fields(row: np.dtype) -> dict[str, tuple[int, int, Any, tuple[int, ...]]]:
    """Return channel to first byte, byte behind, torch's dtype and shape."""
    torch, layout = _torch(), {}
    fields: Any = row.fields
    for name, (kind, offset) in fields.items():
        torch_dtype = torch.from_numpy(np.empty(0, kind.base)).dtype
        layout[name] = (offset, offset + kind.itemsize, torch_dtype, kind.shape)
    return layout


def _words(rows: NDArray) -> NDArray[np.int64]:
    """Return a copy of the rows as words; their dtype is whole words long."""
    return np.array(rows).view(_WORD).reshape(len(rows), rows.dtype.itemsize // _WORD.itemsize)


def _index(count: int, device: str) -> Callable[[ArrayLike], torch.Tensor]:
    """Return what turns numbers into an index on the device; a GPU would not say which is out of range."""
    torch = _torch()

    def index(numbers: ArrayLike) -> Any:
        window_ids = np.asarray(numbers, np.int64)
        if len(window_ids) and not -count <= window_ids.min() <= window_ids.max() < count:
            raise IndexError(f"window {window_ids.max()} of {count}")
        return torch.from_numpy(window_ids % count).to(device)

    return index


def _torch() -> Any:
    """Return the package."""
    try:
        import torch
    except ImportError:
        raise MissingExtraError("torch", "train") from None
    return torch
