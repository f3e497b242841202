"""The order of a quaternion's columns, where their names tell it."""

from __future__ import annotations

import pytest

from candata.errors import UsageError
from candata.formats._mapping import plans
from candata.schema.scene import TableMap


def mapping(*pose: str) -> TableMap:
    return TableMap(file="a.csv", time_s="t", rate_hz=80, channels={"object_pose": pose})


def test_a_real_part_that_comes_last_is_refused(tmp_path):
    with pytest.raises(UsageError) as caught:
        plans(mapping("x", "y", "z", "qx", "qy", "qz", "qw"), tmp_path / "map.yaml")
    assert str(caught.value).startswith("the quaternion's columns are in the order x y z w\n  expected: w x y z\n")


@pytest.mark.parametrize("last", [("qw", "qx", "qy", "qz"), ("q0", "q1", "q2", "q3")])
def test_other_names_are_taken_as_they_stand(tmp_path, last):
    (plan,) = plans(mapping("x", "y", "z", *last), tmp_path / "map.yaml")
    assert plan.columns[3:] == last
