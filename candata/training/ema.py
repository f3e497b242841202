"""Exponential moving average of weights whose memory grows with the run."""

from __future__ import annotations

from collections.abc import Mapping

import torch

#: The average never forgets slower than this. Source: C. Chi et al., "Diffusion Policy", RSS 2023, published code.
MOST_DECAY = 0.9999


def decay(step: int, power: float) -> float:
    """Return the weight of the old average at update `step`, counted from 0.

    Source: K. Crowson's EMA warm-up, 1 - (1 + step)^-power, as in diffusers' `EMAModel` with inv_gamma 1.
    """
    return min(MOST_DECAY, 1 - (1 + step) ** -power) if step > 0 else 0.0


def start_average(parameters: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return a copy to start an average from."""
    return {name: value.detach().clone() for name, value in parameters.items()}


@torch.no_grad()
def update(average: Mapping[str, torch.Tensor], values: Mapping[str, torch.Tensor], step: int, power: float) -> None:
    """Move the average, in place, towards `values`; what is no float (a counter) is copied."""
    is_float = {name: mean.is_floating_point() for name, mean in average.items()}
    means = [mean for name, mean in average.items() if is_float[name]]
    torch._foreach_lerp_(means, [values[name] for name in average if is_float[name]], 1 - decay(step, power))
    for name, mean in average.items():
        if not is_float[name]:
            mean.copy_(values[name])
