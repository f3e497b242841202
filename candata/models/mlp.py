"""`mlp`: the deterministic baseline: the flattened history to pose increments; all its samples are equal."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from candata.loaders import Normaliser
from candata.models._config import MlpConfig, check_sizes, parser
from candata.models._contract import Batch, Model, Sizes
from candata.models._deterministic import Deterministic
from candata.models._encoders import mlp
from candata.models._inputs import Reader
from candata.models._members import with_members


class Mlp(Deterministic):
    """Linear layers with Mish from everything read to H increments."""

    def __init__(self, config: MlpConfig, sizes: Sizes, normaliser: Normaliser) -> None:
        super().__init__()
        self.sizes = sizes
        self.reader = reader = Reader(config, sizes, normaliser)
        history_inputs = sizes.history * (reader.history_size + reader.contact_size)
        inputs = history_inputs + reader.place_size + sizes.horizon * reader.plan_size
        self.layers = mlp(inputs, *[config.width] * config.layers, sizes.horizon * 6)

    def normalised_increments(self, batch: Batch) -> Tensor:
        """Return normalised increments `(B, H, 6)`."""
        increments: Tensor = self.layers(torch.cat([part.flatten(1) for part in self.reader(batch)], dim=-1))
        return increments.unflatten(-1, (self.sizes.horizon, 6))


def _build(config: MlpConfig, sizes: Sizes, normaliser: Normaliser) -> nn.Module:
    """Return the module with the first weights of the configuration's seed."""
    check_sizes(config, sizes)
    return with_members(config, lambda: Mlp(config, sizes, normaliser))


MODEL = Model(
    "deterministic baseline: history to pose increments",
    ("object_pose", "joint_position", "action"),
    {
        "small": MlpConfig(width=256, layers=2),
        "base": MlpConfig(),
        "paper": MlpConfig(planned_actions=False, fingertip_points=False),
    },
    parser(MlpConfig),
    _build,
    {"contact_history": "contact", "fingertip_contact": "fingertip_contact"},
)
