"""`contact_diffusion`: the contact-aware dynamics model: contact first, then diffusion over pose increments under it.

Source: "Contact-Aware Neural Dynamics", arXiv 2601.12796; what it leaves open are fields of the configuration.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from candata.loaders import Normaliser
from candata.models._config import DIFFUSION_PRESETS, ContactConfig, check_sizes, parser
from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.models._diffusion import uniform
from candata.models._encoders import mlp
from candata.models._inputs import masked_mean
from candata.models._members import with_members
from candata.models.diffusion_unet import DiffusionUNet


class ContactDiffusion(DiffusionUNet):
    """Stage I forecasts the contact from z; stage II denoises under h = [z; f_c]."""

    config: ContactConfig

    def __init__(self, config: ContactConfig, sizes: Sizes, normaliser: Normaliser) -> None:
        super().__init__(config, sizes, normaliser, extra_features=config.contact_features)
        self.contact_head = mlp(config.latent, config.latent, sizes.horizon)
        self.contact_feature = mlp(sizes.horizon, config.contact_features, config.contact_features)

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return `contact`, `diffusion`, and `loss` = contact + lambda diffusion; unknown steps count in none."""
        inputs = self.reader(batch)
        z = self.encoder(batch, inputs)
        logits = self.contact_head(z)
        is_known = ~batch["future_pad"]
        truth = torch.where(is_known, batch["future/contact"].to(z.dtype), torch.zeros_like(logits))
        contact = masked_mean(binary_cross_entropy_with_logits(logits, truth, reduction="none"), is_known)
        contact_input = self._contact_input(logits, truth, is_known, generator)
        diffusion = self.diffusion_loss(batch, inputs, self._condition(z, contact_input), generator)
        loss = contact + self.config.diffusion_weight * diffusion
        return {"loss": loss, "contact": contact, "diffusion": diffusion}

    @torch.no_grad()
    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return `samples` forecasts by `steps` sampling steps, and the probability of contact."""
        inputs = self.reader(batch)
        z = self.encoder(batch, inputs)
        contact = self.contact_head(z).sigmoid()
        return Forecast(self.sample(inputs, self._condition(z, contact), samples, steps, generator), contact)

    def _condition(self, z: Tensor, contact: Tensor) -> Tensor:
        """Return h = [z; f_c]."""
        return torch.cat([z, self.contact_feature(contact)], dim=-1)

    def _contact_input(self, logits: Tensor, truth: Tensor, is_known: Tensor, generator: torch.Generator) -> Tensor:
        """Return the contact `(B, H)` that the denoiser is trained on; unknown steps are always predicted ones."""
        predicted = logits.sigmoid()
        if self.config.contact_grad == "stop":
            predicted = predicted.detach()
        if self.config.contact_input == "predicted":
            return predicted
        use = is_known
        if self.config.contact_input == "mixed":
            use = is_known & (uniform((len(is_known), 1), logits, generator) < 0.5)
        return torch.where(use, truth, predicted)


def _build(config: ContactConfig, sizes: Sizes, normaliser: Normaliser) -> nn.Module:
    """Return the module with the first weights of the configuration's seed."""
    check_sizes(config, sizes)
    return with_members(config, lambda: ContactDiffusion(config, sizes, normaliser))


MODEL = Model(
    "forecasts contact, then pose increments by denoising diffusion under it",
    ("object_pose", "joint_position", "action", "contact"),
    {name: ContactConfig(**values) for name, values in DIFFUSION_PRESETS.items()},
    parser(ContactConfig),
    _build,
    {"fingertip_contact": "fingertip_contact"},
)
