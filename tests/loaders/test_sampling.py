"""Which windows a step takes follows from (seed, step, rank) alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.errors import UsageError
from candata.loaders import Sampler


@given(st.integers(1, 50), st.integers(1, 12), st.integers(1, 4), st.integers(0, 2**64 - 1))
def test_all_ranks_together_meet_each_window_once_an_epoch(count, batch_size, world, seed):
    steps = 3 * count // (batch_size * world) + 3
    samplers = [Sampler((count,), batch_size, seed, rank, world) for rank in range(world)]
    line = np.concatenate([sampler.indices(step) for step in range(steps) for sampler in samplers])
    for epoch in range(len(line) // count):
        np.testing.assert_array_equal(np.sort(line[epoch * count : (epoch + 1) * count]), np.arange(count))


def test_a_step_does_not_depend_on_what_was_drawn_before():
    whole = [Sampler((1000,), 32, seed=5).indices(step) for step in range(100)]
    for step in (99, 0, 40, 31):
        np.testing.assert_array_equal(Sampler((1000,), 32, seed=5).indices(step), whole[step])


def test_epochs_and_seeds_differ():
    sampler = Sampler((100,), 100, seed=1)
    assert (sampler.indices(0) != sampler.indices(1)).any()
    assert (sampler.indices(0) != Sampler((100,), 100, seed=2).indices(0)).any()


def test_the_stream_is_fixed():
    """Changing it would make a resumed training see other data: pinned, as numpy pins Philox."""
    assert Sampler((10,), 10, seed=7).indices(0).tolist() == PINNED


PINNED = [8, 4, 1, 6, 3, 2, 7, 5, 9, 0]


@pytest.mark.parametrize(
    "arguments",
    [
        {"counts": (0,)},
        {"batch_size": 0},
        {"world": 0},
        {"rank": 1},
        {"rank": -1},
        {"seed": -1},
        {"seed": 2**64},
    ],
)
def test_numbers_out_of_range(arguments):
    with pytest.raises(UsageError):
        Sampler(**{"counts": (10,), "batch_size": 2} | arguments)


def test_sources_of_one_size_are_shuffled_apart():
    line = Sampler((50, 50), 100, seed=3, parts=(1, 1)).indices(0)
    first, second = line[line < 50], line[line >= 50] - 50
    np.testing.assert_array_equal(np.sort(first), np.sort(second))
    assert (first != second).any()
    np.testing.assert_array_equal(first, Sampler((50,), 50, seed=3).indices(0))
