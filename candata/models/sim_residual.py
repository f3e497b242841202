"""`sim_residual`: what the simulator forecasts, corrected: what the network denoises is added to its increments.

The network gives the clean correction and its last layer begins at zero, so an untrained network is the simulator.
A gain scales what is added; training ends by choosing it (`candata.training.correction_gain`).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from candata.errors import DataError, UsageError
from candata.loaders import Normaliser
from candata.models._config import DIFFUSION_PRESETS, DiffusionConfig, check_sizes, parser
from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.models._inputs import Inputs
from candata.models._members import with_members
from candata.models._poses import increments
from candata.models.diffusion_unet import DiffusionUNet

#: Features of a step that the simulator gives: its increment, and whether the hand touches.
SIMULATED_FEATURES = 6 + 1


class SimResidual(DiffusionUNet):
    """Denoises what the simulator's increments lack, under the history, the plan and the simulator's forecast."""

    def __init__(self, config: DiffusionConfig, sizes: Sizes, normaliser: Normaliser) -> None:
        super().__init__(config, sizes, normaliser, step_features=SIMULATED_FEATURES)
        self.gain: Tensor
        self.register_buffer("gain", torch.ones(()))

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return `loss`, the mean squared error of the denoised correction over the steps that are known."""
        inputs = self.reader(batch)
        condition = self.encoder(batch, inputs)
        return {"loss": self.diffusion_loss(batch, self._with_simulated(batch, inputs), condition, generator)}

    @torch.no_grad()
    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return `samples` forecasts, each by `steps` sampling steps, and the simulator's contact."""
        inputs = self.reader(batch)
        condition = self.encoder(batch, inputs)
        sampled = self.sample(self._with_simulated(batch, inputs), condition, samples, steps, generator)
        # A sample of zero stands for the centre of the increments; a correction of zero is none.
        corrected = self._simulated(batch) + self.gain * (sampled - self.reader.increment_centre)
        return Forecast(corrected, batch["simulated/contact"].to(corrected.dtype))

    def target(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return what the simulator's increments lack `(B, H, 6)`, over their scale, and where it is known."""
        value, is_known = super().target(batch)
        lacking = value - self._normalised(self._simulated(batch))
        return torch.where(is_known[..., None], lacking, torch.zeros_like(lacking)), is_known

    def _with_simulated(self, batch: Batch, inputs: Inputs) -> Inputs:
        """Return the inputs with the simulator's forecast beside the plan."""
        simulated = self._normalised(self._simulated(batch))
        contact = 2 * batch["simulated/contact"].to(simulated.dtype)[..., None] - 1
        return inputs._replace(plan=torch.cat([inputs.plan, simulated, contact], dim=-1))

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


def _build(config: DiffusionConfig, sizes: Sizes, normaliser: Normaliser) -> nn.Module:
    """Return the module with the first weights of the configuration's seed."""
    check_sizes(config, sizes)
    if config.target != "x0":
        raise UsageError(
            "sim_residual denoises its correction itself",
            expected="target: x0",
            found=f"target: {config.target}",
            fix="leave `target` out: an untrained net would not be the simulator",
        )
    return with_members(config, lambda: SimResidual(config, sizes, normaliser))


MODEL = Model(
    "corrects the simulator's forecast: untrained, it is the simulator",
    ("object_pose", "joint_position", "action"),
    {name: DiffusionConfig(**{**values, "target": "x0"}) for name, values in DIFFUSION_PRESETS.items()},
    parser(DiffusionConfig),
    _build,
    {"contact_history": "contact", "fingertip_contact": "fingertip_contact"},
    needs_simulator=True,
)
