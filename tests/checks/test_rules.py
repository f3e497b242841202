from __future__ import annotations

import json
from types import MappingProxyType

import numpy as np
import pytest

from candata import plugins
from candata.checks import check
from candata.datasets import RawEpisode, append, create_dataset, open_dataset, put_cloud
from candata.datasets.encode import hash_columns
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage

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
    return list(plugins.load("candata.checks", "RULE", rule).episode(episode))


TIME = np.arange(ROWS) * 12_500_000
FLAGS = np.arange(ROWS) != 3


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


def test_no_rule_trips_over_an_episode_that_is_nothing():
    empty = raw(time_ns=TIME[:0], object_pose=pose()[:0])
    for rule in plugins.names("candata.checks"):
        findings(rule, empty)
        findings(rule, RawEpisode("e", "{", {}, ""))
    assert "no rows" in findings("schema", empty)[0].message


def unchecked(sound, **changes):
    """Return an episode that its own constructor would refuse."""
    episode = object.__new__(Episode)
    object.__setattr__(episode, "meta", sound.meta)
    object.__setattr__(episode, "arrays", MappingProxyType(dict(sound.arrays) | changes))
    return episode


@pytest.fixture
def root(tmp_path):
    return create_dataset(tmp_path / "ds")


def test_check_reports_what_would_not_construct(root, episode):
    sound = episode("b")
    bad = unchecked(sound, joint_position=with_value(sound["joint_position"], (4, 0), np.nan))
    append(root, [episode("a"), bad], Lineage(operation="test"))
    (found,) = check(open_dataset(root))
    assert (found.rule, found.episode, found.channel, found.index) == ("finite", "b", "joint_position", 4)


def test_check_is_silent_on_a_sound_dataset_and_tells_its_progress(root, episode):
    append(root, [episode(f"e{i}", seed=i) for i in range(5)], Lineage(operation="test"), part_size=2)
    calls = []
    assert check(open_dataset(root), lambda: calls.append(1)) == ()
    assert len(calls) == 3


@pytest.mark.parametrize("name", ["part.json", "steps.parquet", "episodes.parquet"])
@pytest.mark.parametrize("damage", ["missing", "flipped"])
def test_check_names_every_damaged_file(root, episode, name, damage):
    append(root, [episode("a"), episode("b", seed=1)], Lineage(operation="test"), part_size=1)
    path = sorted(root.glob(f"parts/*/{name}"))[0]
    data = path.read_bytes()
    half = len(data) // 2
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(data[:half] + bytes([data[half] ^ 0xFF]) + data[half + 1 :])
    found = check(open_dataset(root, partial=True))
    assert any(f.rule == "hashes" and f"{path.relative_to(root)}: " in f.message for f in found)


def test_check_names_a_missing_cloud(root, episode):
    cloud = put_cloud(root, np.zeros((4, 3)))
    append(root, [episode("a", point_cloud=cloud)], Lineage(operation="test"))
    assert check(open_dataset(root)) == ()
    (root / "objects" / f"{cloud}.parquet").unlink()
    (found,) = check(open_dataset(root))
    assert (found.episode, found.channel) == ("a", "point_cloud")
    assert "no such file" in found.message
