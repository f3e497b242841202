"""Encoders: the history, the contact, the cloud, the plan, and the MLP that fuses them to z."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from candata.errors import DataError
from candata.models._activations import Mish
from candata.models._config import UnetConfig
from candata.models._contract import Batch, Sizes
from candata.models._convolutions import as_image, convolution
from candata.models._inputs import Inputs, Reader, turn_points

#: Divides clouds, so that hand-sized objects are of size one [m]. A round number; the size itself stays visible.
CLOUD_SCALE_M = 0.1
#: Features of the past contact, and kernel of the temporal encoder: the paper (arXiv 2601.12796) gives neither.
CONTACT_FEATURES, TEMPORAL_KERNEL = 64, 3


def mlp(*sizes: int) -> nn.Sequential:
    """Return linear layers of these sizes with Mish between them."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), Mish()]
    return nn.Sequential(*layers[:-1])


class TemporalEncoder(nn.Module):
    """Two convolutions over time, then a linear layer over all rows."""

    def __init__(self, inputs: int, rows: int, width: int, outputs: int, groups: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            convolution(inputs, width, TEMPORAL_KERNEL, groups),
            convolution(width, width, TEMPORAL_KERNEL, groups),
            nn.Flatten(),
            nn.Linear(width * rows, outputs),
        )

    def forward(self, rows: Tensor) -> Tensor:
        """Return features `(B, outputs)` of `rows (B, T, inputs)`."""
        features: Tensor = self.layers(as_image(rows.transpose(1, 2)))
        return features


class PointNet(nn.Module):
    """The same MLP for each point, then the maximum over points: the order of the points does not matter.

    Source: C. Qi et al., "PointNet", arXiv 1612.00593, section 4.2, without its transform networks; layer norms as in
    Y. Ze et al., "3D Diffusion Policy", arXiv 2403.03954, section III.
    """

    def __init__(self, widths: Sequence[int], outputs: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for layer_inputs, layer_outputs in zip([3, *widths[:-1]], widths, strict=True):
            layers += [nn.Linear(layer_inputs, layer_outputs), nn.LayerNorm(layer_outputs), nn.ReLU()]
        self.each = nn.Sequential(*layers)
        self.all = nn.Sequential(nn.Linear(widths[-1], outputs), nn.LayerNorm(outputs))

    def forward(self, points: Tensor) -> Tensor:
        """Return features `(C, outputs)` of clouds `(C, N, 3)` [m]."""
        features: Tensor = self.all(self.each(points / CLOUD_SCALE_M).amax(dim=-2))
        return features


class HistoryEncoder(nn.Module):
    """All of the history as one vector z."""

    def __init__(self, config: UnetConfig, sizes: Sizes, reader: Reader) -> None:
        super().__init__()
        z, width, groups = config.latent, config.temporal_width, config.groups
        self.config = config
        self.reader = reader
        self.temporal = TemporalEncoder(reader.history_size, sizes.history, width, z, groups)
        parts = z + reader.place_size
        if reader.contact_size:
            self.contact = mlp(sizes.history * reader.contact_size, CONTACT_FEATURES, CONTACT_FEATURES)
            parts += CONTACT_FEATURES
        if reader.plan_size:
            self.plan = TemporalEncoder(reader.plan_size, sizes.horizon, width, width, groups)
            parts += width
        if config.cloud != "none":
            self.cloud = PointNet(config.point_widths, z)
            parts += z
        self.fuse = mlp(parts, z, z)

    def forward(self, batch: Batch, inputs: Inputs) -> Tensor:
        """Return z `(B, latent)`.

        Raises
        ------
        DataError
            When the configuration reads clouds and the batch has none.
        """
        parts = [self.temporal(inputs.history), inputs.place]
        if self.reader.contact_size:
            parts.append(self.contact(inputs.contact.flatten(1)))
        if self.reader.plan_size:
            parts.append(self.plan(inputs.plan))
        if self.config.cloud != "none":
            parts.append(self._cloud(batch))
        latent: Tensor = self.fuse(torch.cat(parts, dim=-1))
        return latent

    def _cloud(self, batch: Batch) -> Tensor:
        """Return features `(B, latent)` of each window's cloud; 0 where it has none.

        In the object's frame each cloud is encoded once; all of them, where they are no more than the windows, as
        finding the distinct ones would make a GPU wait.
        """
        _check_clouds(batch)
        cloud_index, clouds = batch["cloud"], batch["clouds"][:, : self.config.cloud_points]
        has_cloud, cloud_index = cloud_index[:, None] >= 0, cloud_index.clamp_min(0)
        if self.config.cloud == "world":
            features = self.cloud(turn_points(batch["history/object_pose"][:, -1], clouds[cloud_index]))
        else:
            if len(clouds) > len(cloud_index):
                distinct_clouds, cloud_index = cloud_index.unique(return_inverse=True)
                clouds = clouds[distinct_clouds]
            features = self.cloud(clouds)[cloud_index]
        return torch.where(has_cloud, features, torch.zeros_like(features))


def chosen_clouds(batch: Batch, points: int | None) -> tuple[Tensor, Tensor]:
    """Return the first points of each window's cloud `(B, P, 3)` [m], and whether it has one `(B) bool`.

    Raises
    ------
    DataError
        When the batch has no clouds.
    """
    _check_clouds(batch)
    return batch["clouds"][:, :points][batch["cloud"].clamp_min(0)], batch["cloud"] >= 0


def _check_clouds(batch: Batch) -> None:
    """Raise DataError when the batch has no clouds."""
    absent_names = [name for name in ("cloud", "clouds") if name not in batch]
    if absent_names:
        raise DataError(
            "the windows lack their clouds",
            expected="cloud (B) and clouds (C, N, 3)",
            found=f"no {', '.join(absent_names)}",
        )
