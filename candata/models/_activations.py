"""Mish, fast on a CPU: its value and slope come from one sigmoid, where torch takes exp, log and tanh each way."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn


class Mish(nn.Module):
    """Mish, x tanh(softplus(x)), of any shape; on a GPU torch's own.

    Source: D. Misra, "Mish", arXiv 1908.08681, eq. 1. With s = sigmoid(x) and a = s (2 - s), tanh(softplus(x)) is
    a / (2 - a), without cancellation.
    """

    def forward(self, x: Tensor) -> Tensor:
        """Return the activation of `x`, of its shape."""
        if x.is_cuda:
            return nn.functional.mish(x)
        value: Tensor = _Mish.apply(x)
        return value


class _Mish(torch.autograd.Function):
    """Keeps the slope t + x s (1 - t^2), where t = tanh(softplus(x)), and nothing else."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        """Return the activation."""
        s = x.sigmoid()
        t = (2 - s).mul_(s)
        value = 2 - t
        t.div_(value)
        torch.mul(x, t, out=value)
        if ctx.needs_input_grad[0]:
            slope = s.mul_(x).mul_(t.square().neg_().add_(1)).add_(t)
            ctx.save_for_backward(slope)
        return value

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        """Return the gradient at x."""
        (slope,) = ctx.saved_tensors
        return gradient * slope
