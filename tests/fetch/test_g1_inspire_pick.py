"""The G1 picks: names, values and clock as recorded; other files are refused."""

from __future__ import annotations

import json

import pytest

from candata.errors import DataError
from candata.fetch import g1_inspire_pick as source


@pytest.fixture
def folder(shared):
    return shared / "realdata" / "g1_inspire_pick"


def test_names_are_those_of_the_recording(folder):
    features = json.loads((folder / "meta" / "info.json").read_text())["features"]
    for key in ("observation.state", "action"):
        assert tuple(name.removeprefix("k") for name in features[key]["names"][0]) == source.JOINTS


def test_the_prepared_episodes(folder):
    episodes = list(source.from_folder(folder).episodes)
    assert len(episodes) == 20
    assert sum(map(len, episodes)) == 7844
    first = episodes[0]
    assert first["joint_position"].shape == first["action"].shape == (479, 26)
    assert first.time_s[-1] == pytest.approx(478 / 30)
    assert (first.meta.source, first.meta.rate_hz) == ("real", 30.0)
    # The right elbow lifts; the left arm holds still.
    moved = first["joint_position"].std(axis=0)
    assert moved[source.JOINTS.index("RightElbow")] > 5 * moved[source.JOINTS.index("LeftElbow")]


def test_a_folder_that_lacks_an_episode_or_holds_another_is_refused(folder, tmp_path):
    with pytest.raises(DataError, match="LICENSE is missing"):
        source.from_folder(tmp_path)
    (tmp_path / "LICENSE").write_bytes((folder / "LICENSE.txt").read_bytes())
    with pytest.raises(DataError, match=r"episode_000000\.parquet is missing"):
        source.from_folder(tmp_path)
    (tmp_path / source.DATA).mkdir(parents=True)
    for index in range(source.EPISODES):
        (tmp_path / source.DATA / f"episode_{index:06d}.parquet").write_bytes(b"PAR1")
    with pytest.raises(DataError, match="the episodes are not the published files"):
        source.from_folder(tmp_path)
