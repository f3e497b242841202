from __future__ import annotations

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.datasets.survey import MOST_SETS, survey
from candata.errors import UnknownNameError
from candata.schema.manifest import Lineage


@pytest.fixture
def made(tmp_path):
    def make(*episodes):
        root = create_dataset(tmp_path / "ds")
        append(root, list(episodes), Lineage(operation="test"))
        return open_dataset(root)

    return make


def test_each_episode_has_a_line_and_is_shown_to_who_watches(made, episode):
    base = episode("c", rows=20)
    valid = {"joint_position_valid": np.arange(20) != 3, "object_pose_valid": np.arange(20) != 4}
    watched = []
    found = survey(
        made(episode("a", rows=40), episode("b", contact=False), type(base)(base.meta, {**base.arrays, **valid})),
        watch=watched.append,
    )
    assert [(e.id, e.rows, e.contact_share, e.invalid_share) for e in found.episodes] == [
        ("a", 40, 0.5, 0.0),
        ("b", 20, None, 0.0),
        ("c", 20, 0.5, 0.1),
    ]
    assert [e.meta.id for e in watched] == ["a", "b", "c"]


def test_distributions_hold_valid_values_of_all_episodes(made, episode):
    found = survey(made(episode("a", seed=1), episode("b", seed=2)))
    names = [(one.channel, one.element.name) for one in found.distributions]
    assert names[:4] == [("time_ns", "step from row to row"), *(("object_pose", axis) for axis in "xyz")]
    assert ("joint_position", "b") in names
    assert ("fingertip_force", "fingertip 1 z") in names
    assert all(one.distribution.count == 40 for one in found.distributions if one.channel != "time_ns")
    assert found.distributions[0].distribution.low == pytest.approx(12.5)


def test_some_episodes_and_unknown_ones(made, episode):
    data = made(episode("a"), episode("b", rows=30))
    found = survey(data, ids=["b"])
    assert (found.summary.episodes, found.summary.rows) == (1, 30)
    with pytest.raises(UnknownNameError, match="'bb'"):
        survey(data, ids=["bb"])


def test_too_many_different_sets_of_joints_are_counted_not_hidden(made, episode):
    many = [episode(f"e{i}", joint_names=(f"a{i}", "b")) for i in range(MOST_SETS + 2)]
    assert survey(made(*many)).sets_left_out == 2


def test_invalid_rows_do_not_count(made, episode):
    base = episode("a")
    values = np.where(np.arange(20)[:, None] < 5, np.nan, 1.0) * np.ones((20, 2))
    arrays = dict(base.arrays) | {"joint_position": values, "joint_position_valid": np.arange(20) >= 5}
    found = survey(made(type(base)(base.meta, arrays)))
    joint = next(one for one in found.distributions if one.channel == "joint_position")
    assert (joint.distribution.count, joint.distribution.low, joint.distribution.high) == (15, 1.0, 1.0)
