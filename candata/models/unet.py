"""`unet`: the deterministic baseline: the denoiser's U-Net over the horizon, without noise or diffusion time.

Source: the UNet baseline of "Contact-Aware Neural Dynamics", arXiv 2601.12796, which says no more of it.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from candata.loaders import Normaliser
from candata.models._config import UNET_PRESETS, UnetConfig, check_sizes, parser
from candata.models._contract import Batch, Model, Sizes
from candata.models._deterministic import Deterministic
from candata.models._encoders import HistoryEncoder
from candata.models._inputs import Reader
from candata.models._members import with_members
from candata.models._unet import UNet


class Unet(Deterministic):
    """Encodes the history to z and maps the plan to H pose increments under it; all samples are equal."""

    places: Tensor

    def __init__(self, config: UnetConfig, sizes: Sizes, normaliser: Normaliser) -> None:
        super().__init__()
        self.reader = Reader(config, sizes, normaliser)
        self.encoder = HistoryEncoder(config, sizes, self.reader)
        inputs = 1 + self.reader.plan_size
        self.unet = UNet(inputs, 6, config.latent, 0, config.widths, config.kernel, config.groups)
        # Without a plan the sequence still says which step is which.
        self.register_buffer("places", torch.linspace(-1, 1, sizes.horizon), persistent=False)

    def normalised_increments(self, batch: Batch) -> Tensor:
        """Return normalised increments `(B, H, 6)`."""
        inputs = self.reader(batch)
        film = self.unet.window_film(self.encoder(batch, inputs))
        places = self.places.expand(len(film), 1, -1)
        increments: Tensor = self.unet(torch.cat([places, inputs.plan.transpose(1, 2)], dim=1), film)
        return increments.transpose(1, 2)


def _build(config: UnetConfig, sizes: Sizes, normaliser: Normaliser) -> nn.Module:
    """Return the module with the first weights of the configuration's seed."""
    check_sizes(config, sizes)
    return with_members(config, lambda: Unet(config, sizes, normaliser))


MODEL = Model(
    "deterministic U-Net: history and plan to pose increments",
    ("object_pose", "joint_position", "action"),
    {name: UnetConfig(**values) for name, values in UNET_PRESETS.items()},
    parser(UnetConfig),
    _build,
    {"contact_history": "contact", "fingertip_contact": "fingertip_contact"},
)
