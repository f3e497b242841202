"""Screening: to which side of its neutral value a number of a vector is followed."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.fit.candidates import candidate
from candata.gap.screening import signature_screen

POINTS = [np.array(u) for u in ((-0.1, 0.0), (0.1, 0.0), (0.0, -0.1), (0.0, 0.1))]


@pytest.fixture
def one_sided(arm):
    """A vector of which the first number helps above neutral, the second below; on the other side contact is chaos."""
    problem = SimpleNamespace(score=SimpleNamespace(loss=lambda z: (z**2).mean(1)), simulated=False)
    here = np.ones((3, 4), np.float32)
    moves = [np.full((3, 4), size, np.float32) for size in (-5.0, 0.5, 0.5, -5.0)]
    return problem, candidate("joint_offset", arm), here, moves


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0)])
def test_a_vector_is_followed_to_the_side_that_leaves_less(one_sided, order):
    problem, c, here, moves = one_sided
    points, moves = [POINTS[i] for i in order], [moves[i] for i in order]
    sides = signature_screen._sides(problem, c, here, points, moves)
    assert sides.tolist() == [np.inf, -np.inf]
    plane = signature_screen._response(c, here, points, moves, False, sides)
    assert plane.slope.mean((1, 2)) == pytest.approx([-5, 5])
    assert np.allclose(plane.read(np.array([0.1, 0.0])), 0.5)
    assert np.allclose(plane.read(np.array([0.0, -0.1])), 0.5)


def test_a_number_at_its_neutral_value_or_probed_on_one_side_is_read_across_what_there_is(one_sided):
    _, c, here, moves = one_sided
    across = signature_screen._response(c, here, POINTS, moves, False, np.zeros(2))
    assert across.slope.mean((1, 2)) == pytest.approx([-27.5, 27.5])
    below = signature_screen._response(c, here, POINTS[::2], moves[::2], False, np.ones(2))
    assert below.slope.mean((1, 2)) == pytest.approx([-50, 5])


def test_nearer_probes_count_where_all_was_simulated_and_the_plane_begins_at_the_best(arm):
    """Far out on the same side it is chaos: of that nothing is learnt."""
    loss = SimpleNamespace(loss=lambda z: (z**2).mean(1))
    c, here = candidate("joint_offset", arm), np.ones((3, 4), np.float32)
    points = [np.array(u) for u in ((-0.1, 0.0), (0.1, 0.0), (0.025, 0.0), (-0.025, 0.0), (0.0, 0.1))]
    moves = [np.full((3, 4), size, np.float32) for size in (-5.0, -4.0, 0.5, -0.5, -1.0)]
    for simulated, slope in ((True, -20.0), (False, 40.0)):
        problem = SimpleNamespace(score=loss, simulated=simulated)
        sides = signature_screen._sides(problem, c, here, points, moves)
        plane = signature_screen._response(c, here, points, moves, False, sides)
        assert plane.slope[0] == pytest.approx(slope)
    begun = signature_screen._begun(SimpleNamespace(score=loss), plane, points, moves)
    assert begun.at.tolist() == [0.025, 0.0]
    assert np.allclose(begun.z, 0.5)
    none = signature_screen._begun(SimpleNamespace(score=loss), plane, points[:2], moves[:2])
    assert none is plane, "no probe leaves less than none"
