"""A linear model: the object's last steps to its next ones. It forecasts no contact, and all its samples are equal."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from candata.loaders import Normaliser
from candata.models import (
    Batch,
    Forecast,
    HistoryConfig,
    Losses,
    Model,
    Sizes,
    increments,
    known_steps,
    masked_mean,
    parser,
    targets,
    with_seed,
)


class Linear(nn.Module):
    """One matrix from the steps of the past, in units of the usual step, to those of the future."""

    def __init__(self, sizes: Sizes, normaliser: Normaliser) -> None:
        super().__init__()
        self.sizes = sizes
        centre, scale = normaliser.increments.arrays()
        # Buffers, so that a checkpoint holds them.
        self.register_buffer("centre", torch.as_tensor(centre).reshape(sizes.horizon, 6))
        self.register_buffer("scale", torch.as_tensor(scale).reshape(sizes.horizon, 6))
        self.layer = nn.Linear((sizes.history - 1) * 6, sizes.horizon * 6)

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return the mean squared error over the steps that are known."""
        wanted = (targets(batch) - self.centre) / self.scale
        return {"loss": masked_mean((self._scaled(batch) - wanted).square().mean(-1), known_steps(batch))}

    @torch.no_grad()
    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return the one forecast, `samples` times."""
        found = self._scaled(batch) * self.scale + self.centre
        return Forecast(found.expand(samples, *found.shape), None)

    def _scaled(self, batch: Batch) -> Tensor:
        """Return normalised increments `(B, H, 6)`; a step from or to a padded row counts as none."""
        padded = batch["history_pad"][:, 1:] | batch["history_pad"][:, :-1]
        past = (increments(batch["history/object_pose"]) - self.centre[0]) / self.scale[0]
        past = torch.where(padded[..., None], 0.0, past)
        return self.layer(past.flatten(1)).unflatten(-1, (self.sizes.horizon, 6))


MODEL = Model(
    summary="linear: the object's last steps to its next ones",
    channels=("object_pose",),
    presets={"small": HistoryConfig()},
    parse=parser(HistoryConfig),
    build=lambda config, sizes, normaliser: with_seed(config.seed, lambda: Linear(sizes, normaliser)),
)
