"""Episodes made again take the place of the old ones in a new version; nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest

from candata.datasets import append, compact_dataset, create_dataset, open_dataset
from candata.datasets.replacing import replace
from candata.errors import DataError
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage


def episode(name: str, value: float) -> Episode:
    meta = EpisodeMeta(id=name, source="real", rate_hz=10.0, joint_names=("a",))
    return Episode(meta, {"time_ns": np.arange(3) * 10**8, "joint_position": np.full((3, 1), value)})


@pytest.mark.parametrize("compacted", [False, True])
def test_replaced_episodes_make_a_new_version_and_the_old_one_stands(tmp_path, compacted):
    root = create_dataset(tmp_path / "set", name="set")
    append(root, [episode(name, 0.0) for name in "abc"], Lineage(operation="made"), part_size=1)
    if compacted:
        compact_dataset(root)
    earlier = open_dataset(root)
    version = replace(root, [episode("b", 1.0), episode("d", 2.0)], Lineage(operation="again"))
    newest = open_dataset(root)
    assert {e.meta.id: float(e["joint_position"][0, 0]) for e in newest} == {"a": 0.0, "b": 1.0, "c": 0.0, "d": 2.0}
    assert [e["joint_position"][0, 0] for e in open_dataset(root, earlier.file.number)] == [0, 0, 0]
    assert version.number == earlier.file.number + 1
    assert version.lineage[-1].operation == "again"
    assert replace(root, [episode("b", 1.0)], Lineage(operation="once more")) == version


def test_an_id_that_comes_twice_with_other_content_is_refused(tmp_path):
    root = create_dataset(tmp_path / "set", name="set")
    with pytest.raises(DataError, match="comes twice"):
        replace(root, [episode("a", 0.0), episode("a", 1.0)], Lineage(operation="made"))
