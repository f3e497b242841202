"""Fourteen real bags: all of them import by one map, and what is bad in them is said."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import DataError, UsageError
from tests.formats.made_bags import read

VICON = "/vicon/Group466CF/Group466CF/pose"
MAP = {"rate_hz": 100, "object": "crazyflie", "channels": {"object_pose": VICON}}


@pytest.fixture(scope="module")
def bags(shared, tmp_path_factory):
    """A folder of links to the bags, beside which maps can be written."""
    source = shared / "realdata" / "crazyflie_vicon_mcap"
    if not source.is_dir():
        pytest.skip("no crazyflie bags")
    folder = tmp_path_factory.mktemp("real") / "bags"
    folder.symlink_to(source, target_is_directory=True)
    return folder


def test_all_import_by_one_map_and_what_is_bad_is_said(bags):
    notes: list[str] = []
    found = {episode.meta.id: episode for episode in read(bags, MAP, allow_gaps=True, note=notes.append)}
    assert len(found) == 14
    assert {name for name, one in found.items() if not one.meta.invalid_counts} == {
        "roll2bag",
        "rollbag",
        "yawbag",
        "yx1bag",
        "yx4bag",
    }
    # The markers of fly90bag were out of sight for 32.6 s.
    assert found["fly90bag"].meta.invalid_counts["object_pose"] == 3284
    for episode in found.values():
        assert 0.006 < episode.meta.alignment.offset_s < 0.009  # header to log, as the README's stamps say
        step = np.diff(episode["time_ns"])
        assert (step == 10_000_000).all()
    assert sum("/cf_appchannel (geometry_msgs/Pose, empty)" in line for line in notes) == 14


def test_a_gap_is_refused_without_being_asked_for(bags):
    with pytest.raises(DataError, match="has a gap"):
        read(bags / "fly90bag", MAP)


def test_nan_unstamped_and_empty_topics_are_refused_by_name(bags):
    def own(**entry):
        return {"rate_hz": 10, "channels": {"object_pose": {"fields": FIELDS, **entry}}}

    estimate = "/cf_logpos"
    with pytest.raises(DataError, match="/cf_logpos has no header stamps"):
        read(bags / "yx4bag", own(topic=estimate))
    with pytest.raises(DataError, match="/cf_logpos is not finite"):
        read(bags / "yx4bag", own(topic=estimate, clock="log"))
    with pytest.raises(DataError, match="topic /cf_appchannel is empty"):
        read(bags / "yx4bag", own(topic="/cf_appchannel", clock="log"))
    with pytest.raises(UsageError, match="a map is needed"):
        read(bags)


FIELDS = [f"position.{a}" for a in "xyz"] + [f"orientation.{a}" for a in "wxyz"]


def test_two_rates_and_two_clocks_meet_on_one_grid(bags):
    """The vehicle's own estimate at 10 Hz, without stamps, beside Vicon's at 100 Hz."""
    entry = {"topic": "/cf_controll", "clock": "log", "fields": ["position.x"], "joints": ["thrust"]}
    mapping = MAP | {"channels": {"object_pose": VICON, "action": entry | {"max_gap_periods": 3}}}
    (episode,) = read(bags / "roll2bag", mapping)
    assert episode.meta.actuator_names == ("thrust",)
    assert len(episode) > 2400
    changes = np.flatnonzero(np.diff(episode["action"][:, 0]))
    assert 9 <= np.median(np.diff(changes)) <= 11
