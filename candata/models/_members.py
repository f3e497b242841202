"""Several nets as one model: what they disagree about is a spread, and their mean errs less than each.

Source: B. Lakshminarayanan et al., "Simple and scalable predictive uncertainty estimation using deep ensembles", arXiv
1612.01474, section 2.4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import nn

from candata.models._config import HistoryConfig
from candata.models._contract import Batch, Forecast, Losses
from candata.models._seed import with_seed


class Members(nn.Module):
    """Nets of one configuration with first weights of their own, trained on the same batches."""

    def __init__(self, nets: list[nn.Module]) -> None:
        super().__init__()
        self.nets = nn.ModuleList(nets)

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return the means of the nets' terms."""
        nets: Any = self.nets
        terms = [net.losses(batch, generator) for net in nets]
        return {name: torch.stack([each[name] for each in terms]).mean() for name in terms[0]}

    @torch.no_grad()
    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return `samples` forecasts, of each net in turn, and the mean of the nets' contacts."""
        nets: Any = self.nets
        each_count = -(-samples // len(nets))
        forecasts = [net.forecast(batch, each_count, steps, generator) for net in nets]
        increments = torch.stack([each.increments for each in forecasts], dim=1).flatten(0, 1)[:samples]
        contacts = [each.contact for each in forecasts if each.contact is not None]
        return Forecast(increments, torch.stack(contacts).mean(0) if contacts else None)


def with_members(config: HistoryConfig, make: Callable[[], nn.Module]) -> nn.Module:
    """Return the net that `make` makes, or the configuration's number of them as one; its seed decides the weights."""
    nets = with_seed(config.seed, lambda: [make() for _ in range(config.members)])
    return nets[0] if len(nets) == 1 else Members(nets)
