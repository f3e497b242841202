"""`sim_residual`: what the simulator forecasts, corrected: the network's output is added to the simulator's increments.

The last layer begins at zero, so an untrained network is the simulator.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from candata.errors import DataError
from candata.loaders import Normaliser
from candata.models._config import UNET_PRESETS, UnetConfig, check_sizes, parser
from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.models._inputs import masked_mean
from candata.models._members import with_members
from candata.models._poses import increments
from candata.models.unet import Unet

#: Features of a step that the simulator gives: its increment, and whether the hand touches.
SIMULATED_FEATURES = 6 + 1


class SimResidual(Unet):
    """The U-Net over the horizon, which also reads the simulator's forecast and corrects it; all samples are equal."""

    def __init__(self, config: UnetConfig, sizes: Sizes, normaliser: Normaliser) -> None:
        super().__init__(config, sizes, normaliser, SIMULATED_FEATURES)

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return `loss`, the mean squared error of the normalised increments over the steps that are known."""
        value, is_known = self.reader.target(batch)
        simulated = self._simulated(batch)
        error = self._normalised(simulated) + self._correction(batch, simulated) - value
        return {"loss": masked_mean(error.square().mean(-1), is_known)}

    @torch.no_grad()
    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return the one forecast, `samples` times, and the simulator's contact."""
        simulated = self._simulated(batch)
        corrected = simulated + self.reader.increment_scale * self._correction(batch, simulated)
        contact = batch["simulated/contact"].to(corrected.dtype)
        return Forecast(corrected.expand(samples, *corrected.shape), contact)

    def _simulated(self, batch: Batch) -> Tensor:
        """Return the simulator's increments `(B, H, 6)` [m, rad], the first one from the observed present pose."""
        absent_names = [name for name in ("simulated/object_pose", "simulated/contact") if name not in batch]
        if absent_names:
            raise DataError(
                "the windows lack what the simulator makes of them",
                expected="simulated/object_pose (B, H, 7) and simulated/contact (B, H)",
                found=f"no {', '.join(absent_names)}",
                fix="forecast with `TrainedModel(..., simulator=...)`",
            )
        present_pose, poses = batch["history/object_pose"][:, -1:], batch["simulated/object_pose"]
        return increments(torch.cat([present_pose, poses], dim=1).to(self.reader.increment_scale.dtype))

    def _normalised(self, steps: Tensor) -> Tensor:
        """Return increments `(B, H, 6)` less their centre, over their scale."""
        return (steps - self.reader.increment_centre) / self.reader.increment_scale

    def _correction(self, batch: Batch, simulated: Tensor) -> Tensor:
        """Return what is added to the simulator's increments `(B, H, 6)`, over their scale; zero before training."""
        contact = 2 * batch["simulated/contact"].to(simulated.dtype)[..., None] - 1
        return self.outputs(batch, (self._normalised(simulated), contact))


def _build(config: UnetConfig, sizes: Sizes, normaliser: Normaliser) -> nn.Module:
    """Return the module with the first weights of the configuration's seed."""
    check_sizes(config, sizes)
    return with_members(config, lambda: SimResidual(config, sizes, normaliser))


MODEL = Model(
    "corrects the simulator's forecast: untrained, it is the simulator",
    ("object_pose", "joint_position", "action"),
    {name: UnetConfig(**values) for name, values in UNET_PRESETS.items()},
    parser(UnetConfig),
    _build,
    {"contact_history": "contact", "fingertip_contact": "fingertip_contact"},
    needs_simulator=True,
)
