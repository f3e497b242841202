"""A 1D U-Net over the horizon, each of its blocks scaled and shifted by the condition (FiLM).

Sources: E. Perez et al., "FiLM", arXiv 1709.07871, eq. 1; the layout (two residual blocks a level, kernel 5, group
norm, Mish) is that of C. Chi et al., "Diffusion Policy", arXiv 2303.04137, section III and its 1D CNN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from candata.models._activations import Mish
from candata.models._convolutions import Convolution, TransposedConvolution, as_image, convolution


class ResidualBlock(nn.Module):
    """Two convolutions with a scale and shift between them, added to the input."""

    def __init__(self, inputs: int, outputs: int, kernel: int, groups: int) -> None:
        super().__init__()
        self.first = convolution(inputs, outputs, kernel, groups)
        self.second = convolution(outputs, outputs, kernel, groups)
        self.skip = Convolution(inputs, outputs, 1) if inputs != outputs else nn.Identity()

    def forward(self, x: Tensor, film: Tensor) -> Tensor:
        """Return `(B, outputs, 1, L)`; `film (B, 2 outputs)` holds scales less one, then shifts."""
        scale, shift = film[..., None, None].chunk(2, dim=1)
        outputs: Tensor = self.second(torch.addcmul(shift, self.first(x), 1 + scale)) + self.skip(x)
        return outputs


class Level(nn.Module):
    """Two residual blocks at one length."""

    def __init__(self, inputs: int, outputs: int, kernel: int, groups: int) -> None:
        super().__init__()
        self.first = ResidualBlock(inputs, outputs, kernel, groups)
        self.second = ResidualBlock(outputs, outputs, kernel, groups)

    def forward(self, x: Tensor, film: Tensor) -> Tensor:
        """Return `(B, outputs, 1, L)`; `film (B, 4 outputs)` is for the first block, then the second."""
        first_film, second_film = film.chunk(2, dim=1)
        outputs: Tensor = self.second(self.first(x, first_film), second_film)
        return outputs


class TimeEmbedding(nn.Module):
    """Sines and cosines of the diffusion time, then a small MLP. Source: arXiv 1706.03762, section 3.5."""

    frequencies: Tensor

    def __init__(self, features: int) -> None:
        super().__init__()
        half_features = features // 2
        powers = torch.arange(half_features) / max(half_features - 1, 1)
        self.register_buffer("frequencies", torch.exp(-math.log(10_000) * powers), persistent=False)
        self.layers = nn.Sequential(
            nn.Linear(2 * half_features, 4 * features), Mish(), nn.Linear(4 * features, features), Mish()
        )

    def forward(self, time: Tensor) -> Tensor:
        """Return features `(S, features)` of times `(S)`."""
        angle = time[:, None] * self.frequencies
        features: Tensor = self.layers(torch.cat([angle.sin(), angle.cos()], dim=-1))
        return features


class UNet(nn.Module):
    """Maps a sequence to another; the condition enters by FiLM at every block, and so does a diffusion time, if any.

    The scales and shifts are linear in [time features; condition], so they are the sum of a part by window and a
    part by time. Sampling computes the first once and the second for all its steps at once. With `time_features` 0
    there is no part by time.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        condition: int,
        time_features: int,
        widths: Sequence[int],
        kernel: int,
        groups: int,
    ) -> None:
        super().__init__()

        pairs = list(zip([inputs, *widths[:-1]], widths, strict=True))
        upward_pairs = list(zip(widths[:0:-1], widths[-2::-1], strict=True))
        self.down = nn.ModuleList(Level(a, b, kernel, groups) for a, b in pairs)
        self.shrink = nn.ModuleList(Convolution(w, w, 3, stride=2) for w in widths[:-1])
        self.middle = Level(widths[-1], widths[-1], kernel, groups)
        self.up = nn.ModuleList(Level(2 * a, b, kernel, groups) for a, b in upward_pairs)
        self.grow = nn.ModuleList(TransposedConvolution(b, b) for _, b in upward_pairs)
        output_layer = Convolution(widths[0], outputs, 1)
        for parameter in output_layer.parameters():
            nn.init.zeros_(parameter)  # the first forecast is the mean of the data
        self.last = nn.Sequential(convolution(widths[0], widths[0], kernel, groups), output_layer)
        self.film_sizes = [4 * width for width in [*widths, widths[-1], *(b for _, b in upward_pairs)]]
        self.by_window = nn.Linear(condition, sum(self.film_sizes))
        if time_features:
            self.by_time = nn.Linear(time_features, sum(self.film_sizes), bias=False)
            self.embed = TimeEmbedding(time_features)
        self.activation = Mish()

    def window_film(self, condition: Tensor) -> Tensor:
        """Return the part of all scales and shifts `(B, S)` that the condition `(B, C)` gives."""
        film: Tensor = self.by_window(self.activation(condition))
        return film

    def time_film(self, time: Tensor) -> Tensor:
        """Return the part of all scales and shifts `(T, S)` that the diffusion times `(T)` give."""
        film: Tensor = self.by_time(self.embed(time))
        return film

    def forward(self, x: Tensor, film: Tensor) -> Tensor:
        """Return the output `(B, outputs, H)` for `x (B, inputs, H)` and `film (B, S)`."""
        films = iter(film.split(self.film_sizes, dim=1))
        skip_features, lengths, x = [], [], as_image(x)
        for number, level in enumerate(self.down):
            lengths.append(x.shape[-1])
            x = level(x, next(films))
            skip_features.append(x)
            if number < len(self.shrink):
                x = self.shrink[number](x)
        x = self.middle(x, next(films))
        for level, grow in zip(self.up, self.grow, strict=True):
            x = level(torch.cat([x, skip_features.pop()], dim=1), next(films))
            lengths.pop()
            x = grow(x)[..., : lengths[-1]]
        output: Tensor = self.last(x).squeeze(2)
        return output
