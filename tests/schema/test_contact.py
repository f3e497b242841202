"""Contact is |Fx| + |Fy| + |Fz| above the threshold, exact where the sensor counts in tenths of a newton."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.schema.contact import fingertip_contact


@pytest.mark.parametrize(
    ("counts", "touching"),
    [((1, 1, 1), False), ((-1, 1, -1), False), ((3, 0, 0), False), ((4, 0, 0), True), ((-2, 1, 1), True)],
)
def test_three_tenths_are_not_above_three_tenths(counts, touching):
    force = np.array(counts) * 0.1
    assert fingertip_contact(force[None, None])[0, 0] == touching


@given(st.lists(st.integers(-50, 50), min_size=3, max_size=3))
def test_counts_and_newtons_agree(counts):
    force = np.array([[counts]]) * 0.1
    assert fingertip_contact(force)[0, 0] == (sum(map(abs, counts)) > 3)


def test_each_fingertip_has_its_own_flag_and_the_threshold_is_a_parameter():
    force = np.zeros((4, 2, 3))
    force[2, 1] = [0.0, 0.0, 1.0]
    assert np.argwhere(fingertip_contact(force)).tolist() == [[2, 1]]
    assert not fingertip_contact(force, threshold_n=1.0).any()


def test_a_missing_force_is_no_contact():
    assert not fingertip_contact(np.full((1, 1, 3), np.nan)).any()
