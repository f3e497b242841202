from __future__ import annotations

import json

import numpy as np
import pytest

from candata import plugins
from candata.checks import EpisodeView
from candata.datasets import RawEpisode
from candata.datasets.encode import hash_columns

ROWS = 20


def pose(norm=1.0):
    return np.tile(np.array([0, 0, 0, norm, 0, 0, 0], np.float32), (ROWS, 1))


def raw(meta=None, **changes):
    """Return a sound stored episode, with columns replaced (None: left out)."""
    arrays = {"time_ns": np.arange(ROWS) * 12_500_000, "object_pose": pose()} | changes
    arrays = {name: array for name, array in arrays.items() if array is not None}
    text = json.dumps({"id": "e", "source": "sim", "rate_hz": 80.0} | (meta or {}))
    return RawEpisode("e", text, arrays, hash_columns(text, arrays))


def with_value(array, place, value):
    changed = array.copy()
    changed[place] = value
    return changed


def findings(rule, episode):
    return list(plugins.load("candata.checks", "RULE", rule).episode(EpisodeView(episode)))


TIME = np.arange(ROWS) * 12_500_000
FLAGS = np.arange(ROWS) != 3
#: Four rows at once, at 30 a second.
BURSTS = np.repeat(np.arange(5), 4) * 133_000_000 + np.tile(np.arange(4), 5) * 10**6


@pytest.mark.parametrize("rule", plugins.names("candata.checks"))
def test_every_rule_is_content_with_a_sound_episode(rule):
    assert plugins.load("candata.checks", "RULE", rule).meaning
    assert findings(rule, raw()) == []


BAD = [
    ("finite", raw(object_pose=with_value(pose(), (3, 1), np.nan)), "object_pose", 3, "1 of 20 rows"),
    ("finite", raw(joint_velocity=np.full((ROWS, 2), np.inf, np.float32)), "joint_velocity", 0, "20 of 20"),
    ("quaternions", raw(object_pose=pose(1.01)), "object_pose", 0, "norm 1.01"),
    ("quaternions", raw(hand_pose=with_value(pose(), (7, 3), 0)), "hand_pose", 7, "norm 0, expected 1"),
    ("time", raw(time_ns=with_value(TIME, 5, TIME[4])), "time_ns", 5, "does not increase: step 0 ns"),
    ("time", raw(time_ns=TIME // 1000), "time_ns", None, "median rate 8e+04 Hz"),
    ("time", raw(time_ns=np.delete(np.arange(ROWS + 1), 8) * 12_500_000), "time_ns", 8, "1 rows, by the steps"),
    ("time", raw(meta={"rate_hz": 30}, time_ns=BURSTS), "time_ns", None, "most steps are 0.001 s"),
    ("time", raw(meta={"rate_hz": 100}), "time_ns", None, "expected rate_hz = 100"),
    ("time", raw(time_ns=TIME + 10**9 * (np.arange(ROWS) > 8)), "time_ns", 9, "gap of 1.01 s"),
    ("schema", raw(meta={"source": "dream"}), None, None, "source"),
    ("schema", raw(meta={"id": "f"}), None, None, "'f'"),
    ("schema", raw(smell=TIME), "smell", None, "unknown channel"),
    ("schema", raw(object_pose=None), None, None, "object_pose, joint_position"),
    ("schema", raw(object_pose=pose()[:, :6]), "object_pose", None, "wrong shape: found (20, 6)"),
    ("schema", raw(object_pose=pose()[:9]), "object_pose", None, "found (9, 7)"),
    ("schema", raw(object_pose=pose().astype(np.float64)), "object_pose", None, "float64, expected float32"),
    ("schema", raw(object_pose_valid=np.ones(3, bool)), "object_pose_valid", None, "wrong shape"),
    ("schema", raw(meta={"joint_names": ["a"]}, joint_position=pose()), "joint_position", None, "J = 1"),
]


@pytest.mark.parametrize(("rule", "episode", "channel", "index", "words"), BAD)
def test_a_rule_says_where_and_what(rule, episode, channel, index, words):
    (found,) = findings(rule, episode)
    assert (found.rule, found.episode, found.channel, found.index) == (rule, "e", channel, index)
    assert words in found.message


@pytest.mark.parametrize(
    ("rule", "pose_in_the_gap"), [("finite", np.nan), ("quaternions", 0.7)], ids=["nan", "not unit"]
)
def test_invalid_rows_are_not_looked_at(rule, pose_in_the_gap):
    changed = with_value(pose(), 3, pose_in_the_gap)
    assert findings(rule, raw(object_pose=changed, object_pose_valid=FLAGS)) == []
    assert len(findings(rule, raw(object_pose=changed))) == 1


def test_levels_tell_the_doubtful_from_the_wrong():
    assert [f.level for f in findings("time", raw(meta={"rate_hz": 100}))] == ["warning"]
    assert [f.level for f in findings("time", raw(meta={"rate_hz": 400}))] == ["error"]


def test_findings_say_when_and_what_to_do():
    (found,) = findings("finite", raw(object_pose=with_value(pose(), (slice(3, 6), 1), np.nan)))
    assert found.ranges == ((0.0375, 0.0625),)
    assert found.evidence == {"rows": 3}
    assert "--allow-gaps" in found.remedy


def test_an_episode_that_is_nothing_is_said_to_be_so():
    assert "no rows" in findings("schema", raw(time_ns=TIME[:0], object_pose=pose()[:0]))[0].message


@pytest.mark.parametrize(("lost", "told"), [(0, False), (2, False), (3, True), (20, True)])
def test_much_that_is_marked_invalid_is_told(lost, told):
    """More than a tenth of the rows: the values there are NaN, which is no error as they do not count."""
    valid = np.arange(ROWS) >= lost
    broken = np.where(valid[:, None], np.ones((ROWS, 2)), np.nan).astype(np.float32)
    found = findings("gaps", raw(joint_velocity=broken, joint_velocity_valid=valid))
    assert [(f.level, f.channel, f.evidence["rows"]) for f in found] == [("info", "joint_velocity", lost)] * told
    assert not findings("finite", raw(joint_velocity=broken, joint_velocity_valid=valid))
