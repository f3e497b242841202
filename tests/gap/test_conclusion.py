"""What a report says of a number that stopped at the end of what is possible."""

from __future__ import annotations

import pytest

from candata.gap.fit.candidates import candidate
from candata.gap.verdict import conclusion


@pytest.mark.parametrize(("part", "stopped"), [(0.5, False), (0.001, False), (0.999, True), (1.0, True)])
def test_a_little_more_than_nothing_is_not_at_its_bound(arm, part, stopped):
    """Of a friction that cannot be less than none."""
    c = candidate("joint_dry_friction", arm)
    assert c.low == c.neutral
    assert conclusion._is_at_bound(c, c.low + part * (c.high - c.low)) is stopped


@pytest.mark.parametrize("end", ["low", "high"])
def test_either_end_of_what_lies_around_the_model_s_own_is_a_bound(arm, end):
    c = candidate("servo_gain", arm)
    assert c.low < c.neutral < c.high
    assert conclusion._is_at_bound(c, getattr(c, end))


def test_one_number_of_several_is_enough_and_a_choice_has_no_bound(arm):
    c = candidate("joint_offset", arm)
    u = c.neutral.copy()
    assert not conclusion._is_at_bound(c, u)
    u[1] = c.high[1]
    assert conclusion._is_at_bound(c, u)
    choice = candidate("integrator", arm)
    assert not conclusion._is_at_bound(choice, choice.high)
