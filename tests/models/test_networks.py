"""The parts of the networks: the cloud's encoder, the U-Net, the condition split into two parts."""

from __future__ import annotations

import pytest
import torch

from candata.models._activations import Mish
from candata.models._convolutions import Convolution, TransposedConvolution, as_image
from candata.models._encoders import PointNet, TemporalEncoder
from candata.models._unet import TimeEmbedding, UNet


@pytest.fixture(autouse=True)
def fixed_first_weights():
    """Bare networks take their first weights from torch's own generator."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        yield


def test_the_order_of_points_does_not_matter(generator):
    net, points = PointNet((8, 16), 12), torch.randn(3, 30, 3, generator=generator(0))
    order = torch.randperm(30, generator=generator(1))
    # The same numbers go through matrix products of another row order, which may round apart.
    torch.testing.assert_close(net(points[:, order]), net(points), rtol=0, atol=1e-6)


def test_one_moved_point_shows(generator):
    net, points = PointNet((8, 16), 12), torch.randn(1, 30, 3, generator=generator(0))
    moved = points.clone()
    moved[0, 3] += 10.0  # far enough to be the maximum of some feature
    assert (net(moved) - net(points)).abs().max() > 1e-3


def test_the_temporal_encoder_sees_the_order_of_rows(generator):
    net, rows = TemporalEncoder(3, 5, 8, 6, 4), torch.randn(2, 5, 3, generator=generator(0))
    assert net(rows).shape == (2, 6)
    assert (net(rows.flip(1)) - net(rows)).abs().max() > 1e-3


@pytest.mark.parametrize("length", [1, 2, 3, 7, 8, 16])
@pytest.mark.parametrize("widths", [(8,), (8, 16), (8, 16, 24)])
def test_the_unet_keeps_any_length(length, widths):
    net = UNet(5, 6, 10, 8, widths, 3, 4)
    film = net.window_film(torch.zeros(2, 10)) + net.time_film(torch.zeros(1))
    assert net(torch.zeros(2, 5, length), film).shape == (2, 6, length)


def test_the_first_output_is_zero(generator):
    net = UNet(6, 6, 10, 8, (8, 16), 3, 4)
    film = net.window_film(torch.randn(2, 10, generator=generator(0))) + net.time_film(torch.ones(1))
    assert not net(torch.randn(2, 6, 8, generator=generator(1)), film).any()


def test_every_block_feels_the_condition(awake, generator):
    net = awake(UNet(6, 6, 10, 8, (8, 16), 3, 4))
    film = (net.window_film(torch.randn(2, 10, generator=generator(0))) + net.time_film(torch.ones(1))).detach()
    film.requires_grad_()
    net(torch.randn(2, 6, 8, generator=generator(1)), film).square().sum().backward()
    # Two blocks a level: two levels down, the middle, one up.
    assert len(net.film_sizes) == 4
    assert all(
        part.abs().max() > 0 for part in film.grad.split([n for size in net.film_sizes for n in (size // 2,) * 2], 1)
    )


def test_the_condition_is_the_sum_of_a_part_by_window_and_a_part_by_time(awake, generator):
    net = awake(UNet(6, 6, 10, 8, (8, 16), 3, 4))
    window, times = torch.randn(3, 10, generator=generator(0)), torch.tensor([5.0, 70.0])
    joint = torch.nn.Linear(18, sum(net.film_sizes))
    with torch.no_grad():
        joint.weight.copy_(torch.cat([net.by_time.weight, net.by_window.weight], 1))
        joint.bias.copy_(net.by_window.bias)
        features = torch.nn.functional.mish(window)
        for i in range(2):
            together = joint(torch.cat([net.embed(times)[i].expand(3, -1), features], 1))
            # Two sums in float32 in place of one.
            torch.testing.assert_close(
                net.window_film(window) + net.time_film(times)[i], together, rtol=1e-5, atol=1e-5
            )


def test_times_are_told_apart():
    found = TimeEmbedding(16)(torch.arange(100.0))
    assert torch.pdist(found).min() > 0


@pytest.mark.parametrize(
    ("kernel", "stride", "length"), [(5, 1, 7), (5, 1, 4), (5, 1, 2), (5, 1, 1), (3, 2, 7), (1, 1, 7)]
)
def test_a_convolution_and_its_gradient_are_torchs_of_the_same_weights(kernel, stride, length, generator):
    net, x = Convolution(3, 8, kernel, stride), torch.randn(2, 3, length, generator=generator(0), requires_grad=True)
    theirs = torch.nn.Conv1d(3, 8, kernel, stride, padding=kernel // 2)
    theirs.load_state_dict(net.state_dict())
    ours, expected = net(as_image(x)).squeeze(2), theirs(x)
    torch.testing.assert_close(ours, expected, rtol=1e-5, atol=1e-6)
    direction = torch.randn(expected.shape, generator=generator(1))
    found, wanted = (
        torch.autograd.grad(y, [x, *layer.parameters()], direction) for y, layer in ((ours, net), (expected, theirs))
    )
    for part, wanted_part in zip(found, wanted, strict=True):
        torch.testing.assert_close(part, wanted_part, rtol=1e-5, atol=1e-5)


def test_a_transposed_convolution_is_torchs_of_the_same_weights(generator):
    net, x = TransposedConvolution(3, 4), torch.randn(2, 3, 5, generator=generator(0))
    theirs = torch.nn.ConvTranspose1d(3, 4, 4, stride=2, padding=1)
    theirs.load_state_dict(net.state_dict())
    torch.testing.assert_close(net(as_image(x)).squeeze(2), theirs(x), rtol=1e-5, atol=1e-6)


def test_mish_and_its_slope_are_torchs():
    x = torch.linspace(-100, 100, 20_001, requires_grad=True)
    exact_x = x.detach().double().requires_grad_()
    value, exact = Mish()(x), torch.nn.functional.mish(exact_x)
    slope, exact_slope = (torch.autograd.grad(y.sum(), at)[0] for y, at in ((value, x), (exact, exact_x)))
    # A few roundings of float32, relative to the value itself: the far left tail keeps its digits.
    torch.testing.assert_close(value.double(), exact, rtol=1e-6, atol=1e-30)
    torch.testing.assert_close(slope.double(), exact_slope, rtol=1e-5, atol=1e-6)
