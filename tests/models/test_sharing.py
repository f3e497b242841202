"""A batch shared by two processes: the mean of their losses and gradients is that of one process with all of it."""

from __future__ import annotations

import pytest
import torch

from candata.models import Share, model_names, sharing

ROWS, WORLD = 6, 2
#: Sums over half as many rows round apart.
ROUNDING = {"rtol": 1e-5, "atol": 1e-6}


def losses_and_gradient(net, batch, generator):
    losses = net.losses(batch, generator(3))
    gradient = torch.autograd.grad(losses["loss"], list(net.parameters()), allow_unused=True)
    return losses, torch.cat([part.flatten() for part in gradient if part is not None])


def part(batch, rank):
    rows = slice(rank * ROWS // WORLD, (rank + 1) * ROWS // WORLD)
    return {name: value if name == "clouds" else value[rows] for name, value in batch.items()}


@pytest.mark.parametrize("name", model_names())
def test_two_halves_give_the_loss_and_gradient_of_the_whole(name, tiny, awake, batch, generator):
    net, whole = awake(tiny(name)), batch(ROWS)
    whole["future_pad"][0, 3:] = True  # the halves hold other numbers of known steps
    counts: list[list[torch.Tensor]] = [[], []]

    def keep(rank):
        return lambda count: counts[rank].append(count) or count

    for rank in range(WORLD):
        with sharing(Share(rank, WORLD, keep(rank))):
            net.losses(part(whole, rank), generator(3))
    totals = [sum(pair) for pair in zip(*counts, strict=True)]
    assert totals
    found = []
    for rank in range(WORLD):
        numbers = iter(totals)
        with sharing(Share(rank, WORLD, lambda _count, numbers=numbers: next(numbers))):
            found.append(losses_and_gradient(net, part(whole, rank), generator))
    losses, gradient = losses_and_gradient(net, whole, generator)
    for term, value in losses.items():
        torch.testing.assert_close(sum(half[term] for half, _ in found) / WORLD, value, **ROUNDING)
    torch.testing.assert_close(sum(part for _, part in found) / WORLD, gradient, **ROUNDING)


def test_the_recorded_contact_is_mixed_in_for_the_same_windows(tiny, awake, batch, generator):
    net, whole = awake(tiny("contact_diffusion", contact_input="mixed")), batch(ROWS)
    with sharing(Share(1, WORLD, lambda count: WORLD * count)):
        second = net.losses(part(whole, 1), generator(3))["diffusion"]
    alone = net.losses(part(whole, 1), generator(3))["diffusion"]
    with sharing(Share(0, WORLD, lambda count: WORLD * count)):
        first = net.losses(part(whole, 0), generator(3))["diffusion"]
    torch.testing.assert_close((first + second) / WORLD, net.losses(whole, generator(3))["diffusion"], **ROUNDING)
    assert not torch.allclose(second, alone, rtol=1e-3), "the second process draws the noise of the first"
