"""Convolutions over time on images of one row: a sequence is `(B, C, 1, L)`, its channels last in memory.

There a CPU convolves and norms the short sequences of these networks faster than as `(B, C, L)`. The weights are those
of 1D convolutions.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from candata.models._activations import Mish


def as_image(x: Tensor) -> Tensor:
    """Return `(B, C, 1, L)`, channels last in memory, of `x (B, C, L)`; no copy of a transposed `(B, L, C)`."""
    return x.unsqueeze(2).contiguous(memory_format=torch.channels_last)


def channels_last(weight: Tensor) -> nn.Parameter:
    """Return the weights `(a, b, kernel)` with b last in memory, as a convolution of images takes them: no copies."""
    return nn.Parameter(weight.detach().transpose(1, 2).contiguous().transpose(1, 2))


class Convolution(nn.Conv1d):
    """A convolution over the time of `(B, C, 1, L)`."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__(inputs, outputs, kernel, stride, padding=kernel // 2)
        self.weight = channels_last(self.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Return `(B, outputs, 1, L')`."""
        if self.kernel_size == (1,):  # a matrix product: half the time of a convolution
            rows = nn.functional.linear(x.permute(0, 2, 3, 1), self.weight[..., 0], self.bias)
            return rows.permute(0, 3, 1, 2)
        if x.shape[-1] < self.kernel_size[0] and self.stride == (1,) and not x.is_cuda:
            outputs: Tensor = _ShortConvolution.apply(x, self.weight, self.bias)
            return outputs
        return nn.functional.conv2d(x, self.weight.unsqueeze(2), self.bias, (1, *self.stride), (0, *self.padding))


class TransposedConvolution(nn.ConvTranspose1d):
    """A transposed convolution over the time of `(B, C, 1, L)`, to twice the length: kernel 4, stride 2, padding 1."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 4, stride=2, padding=1)
        self.weight = channels_last(self.weight)

    def forward(self, x: Tensor, output_size: list[int] | None = None) -> Tensor:
        """Return `(B, outputs, 1, 2 L)`."""
        return nn.functional.conv_transpose2d(x, self.weight.unsqueeze(2), self.bias, (1, 2), (0, 1))


def convolution(inputs: int, outputs: int, kernel: int, groups: int) -> nn.Sequential:
    """Return convolution over time, group norm, Mish: `(B, inputs, 1, L)` to `(B, outputs, 1, L)`."""
    return nn.Sequential(Convolution(inputs, outputs, kernel), nn.GroupNorm(groups, outputs), Mish())


class _ShortConvolution(torch.autograd.Function):
    """A convolution over fewer rows than its kernel has; its gradient takes no products with the padding.

    With 4 rows and a kernel of 5 that is 14 products of matrices in place of 20.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """Return `(B, outputs, 1, L)` of `x (B, inputs, 1, L)` and `weight (outputs, inputs, kernel)`."""
        ctx.save_for_backward(x, weight)
        return nn.functional.conv2d(x, weight.unsqueeze(2), bias, padding=(0, weight.shape[2] // 2))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the gradients at x, weight and bias: row l of the output sees rows l - kernel // 2 and on of x."""
        x, weight = ctx.saved_tensors
        count, inputs, _, length = x.shape
        outputs, _, kernel = weight.shape
        rows = x.permute(0, 2, 3, 1).reshape(count, length * inputs)
        taps = weight.transpose(1, 2).reshape(outputs, kernel * inputs)
        gradients = gradient.permute(0, 2, 3, 1).reshape(count, length * outputs)
        at_rows, at_taps = torch.zeros_like(rows), torch.zeros_like(taps)
        for number, part in enumerate(gradients.split(outputs, dim=1)):
            first_row = number - kernel // 2
            begin, end = max(first_row, 0), min(first_row + kernel, length)
            seen = slice(begin * inputs, end * inputs)
            used = slice((begin - first_row) * inputs, (end - first_row) * inputs)
            at_rows[:, seen].addmm_(part, taps[:, used])
            at_taps[:, used].addmm_(part.t(), rows[:, seen])
        at_x = at_rows.view(count, 1, length, inputs).permute(0, 3, 1, 2)
        at_weight = at_taps.view(outputs, kernel, inputs).transpose(1, 2)
        return at_x, at_weight, gradients.view(-1, outputs).sum(0)
