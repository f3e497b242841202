"""Public recordings: what their own descriptions say is wrong, and nothing that is not."""

from __future__ import annotations

import numpy as np
import pytest

from candata import plugins
from candata.checks import EpisodeView, check, defects
from candata.datasets import append, create_dataset, open_dataset
from candata.formats.table import read_mapped
from candata.schema.episode import ContactRule, Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from candata.schema.scene import TableMap
from tests.formats.made_bags import read


def source(name):
    return plugins.load("candata.fetch", "SOURCE", name)


def findings(root):
    """Level, rule and first words of what is found above `unknown`."""
    return [(f.level, f.rule, f) for f in check(open_dataset(root)) if f.level != "unknown"]


def stored(tmp_path, episodes):
    root = create_dataset(tmp_path / "ds")
    append(root, episodes, Lineage(operation="test"))
    return root


@pytest.mark.parametrize("name", ["cube_tosses", pytest.param("elbow_tosses", marks=pytest.mark.slow)])
def test_tosses_fall_two_per_cent_short_and_nothing_is_wrong(tmp_path, shared, name):
    (found,) = findings(stored(tmp_path, source(name).from_folder(shared / "realdata" / name).episodes))
    assert found[:2] == ("info", "free_fall")
    # The cubes' description gives 9.62 of 9.81 m/s2; the elbows came from the same cameras.
    assert found[2].evidence["of_gravity"] == pytest.approx(0.982, abs=0.005)


def test_the_picking_thumb_stops_short_and_nothing_is_wrong(tmp_path, shared):
    picks = source("g1_inspire_pick").from_folder(shared / "realdata" / "g1_inspire_pick")
    (found,) = findings(stored(tmp_path, picks.episodes))
    assert found[:2] == ("info", "dead_joint")
    assert list(found[2].evidence) == ["RightHandThumbBend"]


def test_a_velocity_of_zeros_is_told_and_is_no_defect(tmp_path, shared):
    path = shared / "realdata" / "cassie_jumps" / "cassie_jumps.parquet"
    joints = (
        "hip_pitch_left",
        "knee_left",
        "ankle_joint_left",
        "ankle_spring_joint_left",
        "toe_left",
        "ankle_spring_joint_right",
        "toe_right",
    )
    base = [f"base_{c}" for c in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    mapping = TableMap(
        file=path.name,
        source="real",
        episode="episode",
        time_s="t",
        rate_hz=2000,
        channels={
            "object_pose": tuple(base),
            "joint_position": joints,
            "joint_velocity": tuple(f"{j}dot" for j in joints),
        },
    )
    found = findings(stored(tmp_path, read_mapped(mapping, path)))
    assert {(level, rule) for level, rule, _ in found} == {("info", "velocities")}
    assert [f.message.split(": ")[1] for _, _, f in found] == ["ankle_spring_joint_left", "ankle_spring_joint_right"]


def bag(name, values, rate_hz=10.0):
    """A stored episode of poses as a bag's estimate holds them, unchecked."""
    arrays = {
        "time_ns": (np.arange(len(values)) * 1e9 / rate_hz).astype(np.int64),
        "object_pose": np.asarray(values, np.float32),
    }
    sound = Episode(
        EpisodeMeta(id=name, source="real", rate_hz=rate_hz),
        {
            "time_ns": arrays["time_ns"],
            "contact": np.zeros(len(values), bool),
            "joint_position": np.zeros((len(values), 1)),
        },
    )
    return defects.with_arrays(defects.as_stored(sound), arrays)


def test_bags_with_nan_and_with_other_quantities_in_their_positions_are_told(judged, rng):
    """As in the quadrotor's bags: NaN throughout in one, values near 84 in the position of others."""
    hover = np.c_[rng.normal([0.1, 1.3, 0.1], 0.002, (200, 3)), np.tile([1.0, 0, 0, 0], (200, 1))]
    other = hover * [0, 0, 0, 1, 1, 1, 1]
    other[:, 2] = rng.normal(84, 0.3, 200)
    found = judged([bag("sound", hover), bag("nan", np.full((200, 7), np.nan)), bag("pitch", other)])
    assert {(f.rule, f.episode) for f in found} == {("finite", "nan"), ("pose_unit", "pitch")}


def test_real_bags_with_other_quantities_in_their_positions_are_told(judged, shared, tmp_path):
    """The height in the estimates of pitch2bag and roll2bag is near 84; flybag's holds metres."""
    (tmp_path / "bags").symlink_to(shared / "realdata" / "crazyflie_vicon_mcap", target_is_directory=True)
    mapping = {"rate_hz": 10, "channels": {"object_pose": {"topic": "/cf_logpos", "clock": "log"}}}
    names = ("pitch2bag", "roll2bag", "flybag")
    episodes = [one for name in names for one in read(tmp_path / "bags" / name, mapping, allow_gaps=True)]
    found = judged(map(defects.as_stored, episodes))
    assert {(f.rule, f.episode) for f in found} == {("pose_unit", "pitch2bag"), ("pose_unit", "roll2bag")}


def test_a_quadrotor_that_rolls_in_its_rig_holds_no_swapped_quaternion(judged):
    """A roll about x at one height, read as x y z w, is an object that stands on its head and turns."""
    angle = 0.6 * np.sin(np.arange(400) / 40)
    pose = np.zeros((400, 7))
    pose[:, 2], pose[:, 3], pose[:, 4] = 0.1, np.cos(angle / 2), np.sin(angle / 2)
    assert judged([bag("rig", pose, 100.0)]) == []


def test_a_view_of_an_episode_has_no_value_where_it_is_invalid(episode):
    raw = defects.as_stored(episode("a"))
    valid = np.arange(20) != 3
    view = EpisodeView(defects.with_arrays(raw, {**raw.arrays, "joint_position_valid": valid}))
    assert np.isnan(view.values("joint_position")[3]).all()
    assert np.isfinite(view.values("joint_position")[valid]).all()


def test_the_check_accepts_an_episode_that_is_cut_out_while_contact_is_held(judged):
    force = np.zeros((200, 1, 3))
    force[:150, 0, 2] = 0.25  # began before the cut
    flags = np.arange(200)[:, None] < 150
    rule = ContactRule(threshold_n=0.3, release_n=0.2)
    for is_wrong in (False, True):
        touch = flags ^ is_wrong
        arrays = {
            "time_ns": np.arange(200) * 10_000_000,
            "fingertip_force": force,
            "joint_position": force[:, 0],
            "fingertip_contact": touch,
        }
        meta = EpisodeMeta(id="e", source="real", rate_hz=100.0, fingertip_names=("tip",), contact_rule=rule)
        episode = defects.as_stored(Episode(meta, arrays | {"contact": touch[:, 0]}))
        assert bool(judged([episode], rules=["contact_flags"])) == is_wrong
