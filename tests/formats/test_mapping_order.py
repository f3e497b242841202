"""The order of a quaternion's columns, where their names tell it."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import UsageError
from candata.formats._table_map import table_picks
from candata.schema.scene import TableMap


def picked(path, *pose: str):
    mapping = TableMap(file="a.csv", time_s="t", rate_hz=80, channels={"object_pose": pose})
    return table_picks(mapping, {name: np.zeros(3) for name in pose}, path / "map.yaml")


def test_a_real_part_that_comes_last_is_refused(tmp_path):
    with pytest.raises(UsageError) as caught:
        picked(tmp_path, "x", "y", "z", "qx", "qy", "qz", "qw")
    assert str(caught.value).startswith("the quaternion's columns are in the order x y z w\n  expected: w x y z\n")


@pytest.mark.parametrize("last", [("qw", "qx", "qy", "qz"), ("q0", "q1", "q2", "q3")])
def test_other_names_are_taken_as_they_stand(tmp_path, last):
    (pick,) = picked(tmp_path, "x", "y", "z", *last)
    assert pick.columns[3:] == last
