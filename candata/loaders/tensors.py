"""Batches as torch tensors: the collate function for a DataLoader. Needs the extra `train`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from numpy.typing import NDArray

from candata.errors import MissingExtraError

if TYPE_CHECKING:
    import torch


def as_tensors(batch: Mapping[str, NDArray]) -> dict[str, torch.Tensor]:
    """Return the batch as tensors that share its memory.

    As `collate_fn`: `DataLoader(windows, batch_size=256, shuffle=True, collate_fn=as_tensors)`; the DataLoader takes
    whole batches from `Windows.__getitems__`. Workers do not pay: sending a batch costs more than gathering it. Where
    there must be some, `collate_fn=dict` sends each array once, and `as_tensors` is for what arrives.

    Raises
    ------
    MissingExtraError
        When torch is not installed.
    """
    try:
        import torch
    except ImportError:
        raise MissingExtraError("torch", "train") from None
    return {name: torch.from_numpy(values) for name, values in batch.items()}
