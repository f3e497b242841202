"""Nets that forecast once: their loss and their forecast."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from candata.models._contract import Batch, Forecast, Losses
from candata.models._inputs import Reader, masked_mean


class Deterministic(nn.Module):
    """Maps what `reader` reads to normalised increments; all its samples are equal."""

    reader: Reader

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return `loss`, the mean squared error of the normalised increments over the steps that are known."""
        value, is_known = self.reader.target(batch)
        return {"loss": masked_mean((self.normalised_increments(batch) - value).square().mean(-1), is_known)}

    @torch.no_grad()
    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return the one forecast, `samples` times; `steps` and `generator` change nothing."""
        increments = self.reader.to_si(self.normalised_increments(batch))
        return Forecast(increments.expand(samples, *increments.shape), None)

    def normalised_increments(self, batch: Batch) -> Tensor:
        """Return normalised increments `(B, H, 6)`; each net says how."""
        raise NotImplementedError
