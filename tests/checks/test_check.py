"""The whole of a validation: files, episodes, the set; what cannot be checked; what may lie on a disk."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from candata.checks import EpisodeView, Finding, check, defects, group_findings, rule_names
from candata.checks.conventions import RULE
from candata.datasets import RawEpisode, append, create_dataset, open_dataset, put_cloud
from candata.datasets.encode import hash_columns
from candata.errors import UnknownNameError
from candata.schema.channels import CHANNELS
from candata.schema.manifest import Lineage

CONTENT = ("finite", "hashes", "quaternions", "schema", "time")


@pytest.fixture
def root(tmp_path):
    return create_dataset(tmp_path / "ds")


def wrong(dataset, **how):
    return [f for f in check(dataset, **how) if f.level in ("error", "warning")]


def test_check_reports_what_would_not_construct(root, episode, rng):
    bad = defects.unchecked_episode(defects.with_defect(episode("b", seed=1), "force_nan", rng, 0.0))
    append(root, [episode("a"), bad], Lineage(operation="test"))
    (found,) = wrong(open_dataset(root), rules=CONTENT)
    row = int(np.argmax(np.isnan(bad["fingertip_force"]).any(axis=(1, 2))))
    assert (found.rule, found.episode, found.channel, found.index) == ("finite", "b", "fingertip_force", row)


def test_progress_is_told_an_episode(root, episode):
    append(root, [episode(f"e{i}", seed=i) for i in range(5)], Lineage(operation="test"), part_size=2)
    calls = []
    assert check(open_dataset(root), lambda: calls.append(1), rules=CONTENT) == ()
    assert len(calls) == 5


@pytest.mark.parametrize("name", ["part.json", "steps.parquet", "episodes.parquet"])
@pytest.mark.parametrize("damage", ["missing", "flipped"])
def test_deep_names_every_damaged_file(root, episode, name, damage):
    append(root, [episode("a"), episode("b", seed=1)], Lineage(operation="test"), part_size=1)
    path = sorted(root.glob(f"parts/*/{name}"))[0]
    data = path.read_bytes()
    half = len(data) // 2
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(data[:half] + bytes([data[half] ^ 0xFF]) + data[half + 1 :])
    found = check(open_dataset(root, partial=True), deep=True)
    assert any(f.rule == "hashes" and f"{path.relative_to(root)}: " in f.message for f in found)


def test_without_deep_a_changed_value_is_found_by_the_content_of_its_episode(root, episode):
    append(root, [episode("a")], Lineage(operation="test"))
    (path,) = root.glob("parts/*/steps.parquet")
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 0xFF
    path.write_bytes(bytes(data))
    assert {f.rule for f in wrong(open_dataset(root), rules=["hashes"])} == {"hashes"}


def test_a_file_of_another_size_is_found_without_deep(root, episode):
    append(root, [episode("a"), episode("b", seed=1)], Lineage(operation="test"), part_size=1)
    path = sorted(root.glob("parts/*/steps.parquet"))[0]
    path.write_bytes(path.read_bytes()[:-9])
    found = wrong(open_dataset(root, partial=True), rules=["hashes"])
    assert any("bytes, expected" in f.message for f in found)


def test_check_names_a_missing_cloud(root, episode):
    cloud = put_cloud(root, np.zeros((4, 3)))
    append(root, [episode("a", point_cloud=cloud)], Lineage(operation="test"))
    assert wrong(open_dataset(root), rules=CONTENT) == []
    (root / "objects" / f"{cloud}.parquet").unlink()
    (found,) = wrong(open_dataset(root), rules=CONTENT)
    assert (found.episode, found.channel) == ("a", "point_cloud")
    assert "no such file" in found.message


def test_what_could_not_be_checked_is_said_once_with_the_reason(root, episode):
    append(root, [episode(f"e{i}", seed=i) for i in range(4)], Lineage(operation="test"))
    found = [f for f in check(open_dataset(root)) if f.level == "unknown"]
    by_rule = {f.rule: f for f in found}
    assert len(by_rule) == len(found)
    assert by_rule["penetration"].message == "not checked in 4 episodes: no scene was given (--scene)"
    assert by_rule["penetration"].evidence == {"episodes": 4}
    assert by_rule["command_lag"].message == "not checked in 4 episodes: no action"


def test_rules_can_be_chosen_and_a_wrong_name_lists_them(root, episode):
    append(root, [episode("a")], Lineage(operation="test"))
    assert check(open_dataset(root), rules=["time"]) == ()
    with pytest.raises(UnknownNameError, match="did you mean 'time'"):
        check(open_dataset(root), rules=["tim"])


def test_the_injector_is_no_rule():
    assert "defects" not in rule_names()


def test_findings_that_are_the_same_in_words_are_one_group(root, episode, rng):
    raws = [defects.with_defect(episode(f"e{i}", seed=i), "quaternion_not_unit", rng, 0.1 + i / 100) for i in range(5)]
    defects.write(root.parent / "bad", raws)
    found = check(open_dataset(root.parent / "bad"), rules=["quaternions"])
    (group,) = group_findings(found)
    assert (len(found), group.episodes, group.problem) == (
        5,
        tuple(f"e{i}" for i in range(5)),
        "a quaternion is not unit",
    )


@st.composite
def stored(draw):
    """An episode of any arrays: any type, any shape, any value, any record."""
    rows = draw(st.integers(0, 12))
    shapes = st.sampled_from([(rows,), (rows, 0), (rows, 2), (rows, 7), (rows, 2, 3), (max(rows - 1, 0), 7)])
    kinds = st.sampled_from(["float32", "float64", "int64", "bool", "int16"])
    names = draw(st.lists(st.sampled_from([*CHANNELS, "object_pose_valid", "smell"]), unique=True))
    arrays = {name: draw(hnp.arrays(draw(kinds), draw(shapes))) for name in names}
    if draw(st.booleans()):
        arrays["time_ns"] = np.cumsum(draw(hnp.arrays("int64", rows, elements=st.integers(-2, 10**9))))
    record = {"id": "e", "source": "sim", "rate_hz": 80.0, "joint_names": ["a"], "fingertip_names": ["f", "g"]}
    return RawEpisode("e", draw(st.sampled_from([json.dumps(record), "{", "[]"])), arrays, "")


class Stored:
    """A dataset of one stored episode that need not lie on a disk."""

    def __init__(self, raw):
        self.raw = raw

    def rows(self):
        return [{"row_group": 0}]

    def group(self, number, rows):
        return [self.raw]


@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(raw=stored())
def test_no_rule_trips_over_whatever_is_stored(raw):
    class Dataset:
        class file:
            exclusions = ()

        @staticmethod
        def raw_parts():
            return [Stored(raw)]

    rules = [name for name in rule_names() if name != "hashes"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # hypothesis draws NaN casts
        for finding in check(Dataset, rules=rules):
            assert finding.message
            json.dumps([dict(finding.evidence), finding.ranges], allow_nan=False)


def told(*messages, episodes=True, problem="far"):
    found = [
        Finding("info", "r", m, f"e{i}" if episodes else None, "c", problem=problem) for i, m in enumerate(messages)
    ]
    (group,) = group_findings(found)
    return group.text


def test_a_group_tells_the_range_of_its_numbers_over_all_episodes():
    assert told("far: 84 m off, expected below 10 m", "far: 3.5 m off, expected below 10 m") == (
        "far: 3.5..84 m off, expected below 10 m"
    )
    assert told("far: -2e-05 of 1.5", "far: -3 of 1.5") == "far: -3..-2e-05 of 1.5"
    assert (
        told("far: index1 by 2 (50%), v2.1.0", "far: index1 by 1 (7%), v2.1.0")
        == "far: index1 by 1..2 (7..50%), v2.1.0"
    )


def test_a_group_tells_the_first_kinds_of_words_and_counts_the_others():
    many = [f"far: {name} by {n}" for name, count in zip("abcde", (1, 2, 1, 1, 1), strict=True) for n in range(count)]
    assert told(*many) == "far: b by 0..1; a by 0; c by 0; 2 more"
    assert told(*many[:2], "far: c by 4", "far: d by 4", episodes=False) == "far: a by 0; b by 0; c by 4; d by 4"


@pytest.mark.parametrize(
    ("simulated", "recorded", "expected"),
    [
        (
            [*"abcdef", "g", "h"],
            [*"abcdef", "h", "g"],
            "joint_names are in another order: simulated g, h; recorded h, g",
        ),
        (
            [*"abc", *(f"s{i}" for i in range(9))],
            [*"abc", "r"],
            "the sources state another joint_names: only simulated s0, s1, s2, s3, s4, s5 and 3 more; only recorded r",
        ),
        ([*"ab"], [*"abc"], "the sources state another joint_names: only recorded c"),
        (["a"], ["b"], "the sources state another joint_names: simulated a; recorded b"),
    ],
)
def test_names_that_the_sources_share_are_not_told(episode, simulated, recorded, expected):
    def stored(name, source, names):
        base = episode(name, source=source, seed=ord(name))
        raw = defects.as_stored(base)
        meta = json.loads(raw.meta_json) | {"joint_names": names}
        return replace(raw, meta_json=json.dumps(meta))

    seen = [
        RULE.gather(EpisodeView(stored(name, source, names)))
        for name, source, names in zip(
            "wxyz", ["sim"] * 2 + ["real"] * 2, [simulated] * 2 + [recorded] * 2, strict=True
        )
    ]
    assert expected in [finding.message for finding in RULE.judge(seen)]


def test_a_hash_is_that_of_what_is_stored(episode, rng):
    raw = defects.with_defect(episode("a"), "pose_in_millimetres", rng)
    assert (
        raw.stored_hash
        == hash_columns(raw.meta_json, raw.arrays)
        != defects.with_defect(episode("a"), "quaternion_swapped", rng).stored_hash
    )
