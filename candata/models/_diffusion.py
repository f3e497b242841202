"""Denoising diffusion: the noise schedule, and samplers that walk from noise to a forecast.

Sources: J. Ho et al., "Denoising diffusion probabilistic models", arXiv 2006.11239, eqs. 4 and 7 (DDPM); A. Nichol and
P. Dhariwal, "Improved denoising diffusion probabilistic models", arXiv 2102.09672, eq. 17 (squared cosine); J. Song
et al., "Denoising diffusion implicit models", arXiv 2010.02502, eq. 12 with sigma 0 (DDIM); S. Lin et al., "Common
diffusion noise schedules and sample steps are flawed", arXiv 2305.08891, section 3.3 (trailing steps).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import torch
from torch import Tensor

from candata.errors import UsageError
from candata.models._sharing import draw_rows

Target = Literal["x0", "epsilon"]
Sampler = Literal["ddim", "ddpm"]

#: Offset and largest beta of the squared-cosine schedule (arXiv 2102.09672, section 3.2).
OFFSET, LARGEST_BETA = 0.008, 0.999


def cosine_alpha_bars(steps: int) -> list[float]:
    """Return the share of the signal's variance that is left after each of `steps` noising steps."""

    def level(share: float) -> float:
        return math.cos((share + OFFSET) / (1 + OFFSET) * math.pi / 2) ** 2

    alpha_bar, alpha_bars = 1.0, []
    for i in range(steps):
        alpha_bar *= 1 - min(1 - level((i + 1) / steps) / level(i / steps), LARGEST_BETA)
        alpha_bars.append(alpha_bar)
    return alpha_bars


def trailing_times(train_steps: int, steps: int) -> list[int]:
    """Return `steps` of the training times, from the last one downwards, evenly apart.

    Raises
    ------
    UsageError
        When there are fewer than one, or more than were trained.
    """
    if not 1 <= steps <= train_steps:
        raise UsageError("impossible number of sampling steps", expected=f"1 to {train_steps}", found=str(steps))
    return [round(train_steps - i * train_steps / steps) - 1 for i in range(steps)]


@dataclass(frozen=True)
class SamplerStep:
    """One step of a sampler: signal left before and after it (alpha-bar; 1 after the last)."""

    signal_before: float
    signal_after: float


@dataclass(frozen=True)
class Process:
    """A trained diffusion: its schedule and what the network predicts.

    Attributes
    ----------
    alpha_bars : tuple of float
        Share of the signal's variance left at each training time.
    target : str
        `x0`, the clean value, or `epsilon`, the noise. Late epsilon errors grow a thousandfold in the clean
        value, so there it is clipped to [-1, 1].
    sampler : str
        `ddim` (deterministic after the first noise) or `ddpm`.
    """

    alpha_bars: tuple[float, ...]
    target: Target
    sampler: Sampler

    def times(self, steps: int) -> list[int]:
        """Return the training times that `steps` sampling steps visit; see `trailing_times`."""
        return trailing_times(len(self.alpha_bars), steps)

    def walk(self, steps: int) -> list[SamplerStep]:
        """Return the steps from noise to the clean value."""
        levels = [self.alpha_bars[t] for t in self.times(steps)]
        return [SamplerStep(a, b) for a, b in zip(levels, [*levels[1:], 1.0], strict=True)]

    def clean(self, x: Tensor, output: Tensor, level: float) -> tuple[Tensor, Tensor]:
        """Return the clean value and the noise that the network's output means for x at alpha-bar `level`."""
        if self.target == "x0":
            return output, (x - math.sqrt(level) * output) / math.sqrt(1 - level)
        value = (x - math.sqrt(1 - level) * output) / math.sqrt(level)
        return value.clamp(-1, 1), output

    def advance(self, x: Tensor, output: Tensor, step: SamplerStep, noise: Tensor | None) -> Tensor:
        """Return x after one step; `noise` (DDPM only) is standard normal, None for the last step."""
        value, epsilon = self.clean(x, output, step.signal_before)
        if self.sampler == "ddim":
            return math.sqrt(step.signal_after) * value + math.sqrt(1 - step.signal_after) * epsilon
        signal_ratio = step.signal_before / step.signal_after
        spread = (1 - step.signal_after) / (1 - step.signal_before)
        mean = (
            math.sqrt(step.signal_after) * (1 - signal_ratio) / (1 - step.signal_before) * value
            + math.sqrt(signal_ratio) * spread * x
        )  # posterior mean, arXiv 2006.11239 eq. 7
        return mean if noise is None else mean + math.sqrt(spread * (1 - signal_ratio)) * noise

    def sample(
        self, denoise: Callable[[Tensor, int], Tensor], noise: Tensor, steps: int, generator: torch.Generator
    ) -> Tensor:
        """Return the clean value reached from `noise`.

        Parameters
        ----------
        denoise : callable
            `(x, i) -> output` of the network at the i-th of the sampling steps.
        noise : tensor
            Standard normal, of the shape of the value.
        steps : int
            Sampling steps.
        generator : torch.Generator
            Draws the noise of DDPM.
        """
        x, walk = noise, self.walk(steps)
        for i, step in enumerate(walk):
            needs_noise = self.sampler == "ddpm" and i + 1 < len(walk)
            x = self.advance(x, denoise(x, i), step, normal(x.shape, x, generator) if needs_noise else None)
        return x


class WindowGenerators(torch.Generator):
    """A generator of a batch of B windows with one for each: what a window draws does not depend on the others.

    Attributes
    ----------
    each : tuple of B torch.Generator
        Generators of the windows. What does not draw by `normal` draws from the batch's.
    """

    each: tuple[torch.Generator, ...] = ()


def normal(shape: tuple[int, ...], template: Tensor, generator: torch.Generator) -> Tensor:
    """Return standard normal numbers from `generator`, of the kind and on the device of `template`.

    Of `WindowGenerators` the rows are samples of each window in turn: row `m B + b` is sample m of window b.
    """
    if isinstance(generator, WindowGenerators) and shape[0] % len(generator.each) == 0:
        window_shape = (shape[0] // len(generator.each), *shape[1:])
        draws = [torch.randn(window_shape, generator=g, device=g.device, dtype=template.dtype) for g in generator.each]
        return torch.stack(draws, dim=1).flatten(0, 1).to(template.device)
    draw = partial(torch.randn, generator=generator, device=generator.device, dtype=template.dtype)
    return draw_rows(draw, shape).to(template.device)


def uniform(shape: tuple[int, ...], template: Tensor, generator: torch.Generator) -> Tensor:
    """Return numbers in [0, 1) from `generator`, of the kind and on the device of `template`."""
    draw = partial(torch.rand, generator=generator, device=generator.device, dtype=template.dtype)
    return draw_rows(draw, shape).to(template.device)


def integers(limit: int, count: int, template: Tensor, generator: torch.Generator) -> Tensor:
    """Return `(count,) int64` from 0 to `limit - 1` from `generator`, on the device of `template`."""
    draw = partial(torch.randint, limit, generator=generator, device=generator.device)
    return draw_rows(draw, (count,)).to(template.device)
