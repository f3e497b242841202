"""A recording for Rerun holds what the episode holds, where the scene's kinematics put it."""

from __future__ import annotations

import importlib.util
import sys

import mujoco
import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset, put_cloud
from candata.errors import MissingExtraError, SetupError, UnknownNameError, UsageError
from candata.reports import rerun_view
from candata.reports.posed import poser
from candata.reports.rerun_view import view
from candata.scenes import load_scene
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

needs_rerun = pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="no rerun-sdk (extra view)")
ROWS = 12


@pytest.fixture(scope="module")
def scene():
    return load_scene("xhand_tabletop")


def make_episode(world, name="e", **changes):
    """An episode whose joints and can wander in the scene `world`."""
    rng, count = np.random.default_rng(5), len(world.file.joints)
    quaternion = rng.normal(size=(ROWS, 4))
    arrays = {
        "time_ns": np.arange(ROWS) * 12_500_000,
        "object_pose": np.c_[rng.normal(size=(ROWS, 3)), quaternion / np.linalg.norm(quaternion, axis=1)[:, None]],
        "joint_position": rng.uniform(0, 1, size=(ROWS, count)),
        "action": rng.uniform(0, 1, size=(ROWS, len(world.file.actuator_names))),
        "fingertip_force": rng.normal(size=(ROWS, 5, 3)),
        "fingertip_contact": np.arange(ROWS)[:, None] % 5 == np.arange(5),
    }
    meta = {
        "id": name,
        "source": "sim",
        "rate_hz": 80.0,
        "scene": "xhand_tabletop",
        "joint_names": world.file.joints,
        "actuator_names": world.file.actuator_names,
        "fingertip_names": world.file.fingertips,
    }
    meta |= {k: changes.pop(k) for k in list(changes) if k in meta or k == "point_cloud"}
    arrays = {k: v for k, v in (arrays | changes).items() if v is not None}
    return Episode(EpisodeMeta.model_validate(meta), arrays)


@pytest.fixture
def dataset(tmp_path):
    def make(*episodes):
        root = create_dataset(tmp_path / "ds")
        append(root, list(episodes), Lineage(operation="test"))
        return open_dataset(root)

    return make


def read(path):
    """Return entity to the rows of its columns, the moving ones and the ones that stand."""
    from rerun.chunk import RrdReader

    moving_entities, static_entities = {}, {}
    for chunk in RrdReader(str(path)).stream():
        (static_entities if chunk.is_static else moving_entities).setdefault(chunk.entity_path, []).append(
            chunk.to_record_batch()
        )
    return moving_entities, static_entities


def column(batches, ending):
    """Return the values of a component of one entity, row by row."""
    name = next(n for n in batches[0].schema.names if n.endswith(ending))
    return [row for batch in batches for row in batch.column(name).to_pylist()]


@needs_rerun
def test_everything_lies_where_the_kinematics_put_it(dataset, scene, tmp_path):
    episode = make_episode(scene)
    assert view(dataset(episode), "e", out=tmp_path / "a.rrd") == ()
    moving_entities, static_entities = read(tmp_path / "a.rrd")
    position = np.array(column(moving_entities["/world/object"], "translation"))[:, 0]
    assert position == pytest.approx(episode["object_pose"][:, :3])
    rotation = np.array(column(moving_entities["/world/object"], "quaternion"))[:, 0]
    assert rotation == pytest.approx(episode["object_pose"][:, [4, 5, 6, 3]])
    data = mujoco.MjData(scene.model)
    data.qpos[scene.joint_qpos] = episode["joint_position"][-1]
    mujoco.mj_kinematics(scene.model, data)
    tip = column(moving_entities["/world/scene/index2"], "translation")[-1][0]
    assert tip == pytest.approx(data.body("index2").xpos, abs=1e-6)  # float32 in the file
    assert any(name.startswith("/world/scene/index2/geom") for name in static_entities)
    assert any(name.startswith("/world/scene/object/geom") for name in static_entities)


@needs_rerun
def test_contact_is_marked_in_its_rows_and_forces_point_in_the_world(dataset, scene, tmp_path):
    episode = make_episode(scene)
    view(dataset(episode), "e", out=tmp_path / "a.rrd")
    moving_entities, _ = read(tmp_path / "a.rrd")
    tip = scene.file.fingertips[0]
    marks = column(moving_entities[f"/world/contact/{tip}"], "positions")
    assert [len(row) for row in marks] == (np.arange(ROWS) % 5 == 0).astype(int).tolist()
    (posed_rows,) = poser(scene, episode).chunks(episode)
    expected = rerun_view.ARROW_M_PER_N * np.einsum(
        "kab,kb->ka", posed_rows.frame[:, 0], episode["fingertip_force"][:, 0]
    )
    assert np.array(column(moving_entities[f"/world/force/{tip}"], "vectors"))[:, 0] == pytest.approx(
        expected, abs=1e-6
    )
    assert np.linalg.norm(expected, axis=1) == pytest.approx(
        rerun_view.ARROW_M_PER_N * np.linalg.norm(episode["fingertip_force"][:, 0], axis=1), rel=1e-5
    )


@needs_rerun
def test_traces_hold_position_command_force_and_contact(dataset, scene, tmp_path):
    episode = make_episode(scene)
    view(dataset(episode), "e", out=tmp_path / "a.rrd")
    moving_entities, static_entities = read(tmp_path / "a.rrd")
    joint = scene.file.joints[3]
    lines = np.array(column(moving_entities[f"/traces/joints/{joint}"], "scalars"))
    command = episode["action"][:, scene.file.actuator_names.index(joint)]
    assert lines == pytest.approx(np.stack([episode["joint_position"][:, 3], command], axis=1))
    assert len([name for name in moving_entities if name.startswith("/traces/joints/")]) == len(scene.file.joints)
    assert len([name for name in moving_entities if name.startswith("/traces/forces/")]) == 5
    assert len([name for name in moving_entities if name.startswith("/traces/contact/")]) == 6
    assert f"/traces/joints/{joint}" in static_entities  # the names of its lines


@needs_rerun
def test_without_a_scene_the_object_and_the_traces_remain(dataset, scene, tmp_path):
    data = dataset(make_episode(scene, scene="mine"))
    cloud = np.random.default_rng(0).normal(size=(30, 3))
    sha = put_cloud(data.path, cloud)
    append(data.path, [make_episode(scene, name="with", scene="mine", point_cloud=sha)], Lineage(operation="test"))
    (note,) = view(open_dataset(data.path), "with", out=tmp_path / "a.rrd")
    assert "no scene" in note
    moving_entities, static_entities = read(tmp_path / "a.rrd")
    assert len(column(static_entities["/world/object/cloud"], "positions")[0]) == 30
    assert not [
        name for name in (*moving_entities, *static_entities) if name.startswith(("/world/scene", "/world/force"))
    ]
    assert view(open_dataset(data.path), "with", "xhand_tabletop", tmp_path / "b.rrd") == ()


@needs_rerun
def test_invalid_rows_are_left_out_and_said(dataset, scene, tmp_path):
    valid = np.arange(ROWS) > 3
    pose = np.where(valid[:, None], make_episode(scene)["object_pose"], np.nan)
    notes = view(dataset(make_episode(scene, object_pose=pose, object_pose_valid=valid)), "e", out=tmp_path / "a.rrd")
    assert notes == (f"object_pose is not valid in 4 of {ROWS} rows: the view holds the last valid one",)
    moving_entities, _ = read(tmp_path / "a.rrd")
    assert len(column(moving_entities["/world/object"], "translation")) == ROWS - 4


@needs_rerun
def test_a_hand_alone_shows_no_object_and_names_missing_joints(dataset, scene, tmp_path):
    names = scene.file.joints[3:]
    episode = make_episode(scene, object_pose=None, joint_names=names, joint_position=np.zeros((ROWS, len(names))))
    (note,) = view(dataset(episode), "e", out=tmp_path / "a.rrd")
    assert ", ".join(scene.file.joints[:3]) in note
    _, static_entities = read(tmp_path / "a.rrd")
    assert not [name for name in static_entities if name.startswith("/world/scene/object")]


@needs_rerun
def test_one_row_and_names_of_any_kind(dataset, scene, tmp_path):
    episode = make_episode(scene)
    names = ("a/b c", "<x>", *scene.file.joints[2:])
    short_episode = {n: a[:1] for n, a in episode.arrays.items()}
    episode = Episode(episode.meta.model_copy(update={"joint_names": names}), short_episode)
    view(dataset(episode), "e", out=tmp_path / "a.rrd")
    moving_entities, _ = read(tmp_path / "a.rrd")
    assert len([name for name in moving_entities if name.startswith("/traces/joints/")]) == len(names)


@needs_rerun
def test_joints_of_another_hand_are_refused_and_nothing_is_left(dataset, scene, tmp_path):
    names = tuple(f"other{i}" for i in range(len(scene.file.joints)))
    data = dataset(make_episode(scene, joint_names=names))
    with pytest.raises(UsageError, match="not those of the scene"):
        view(data, "e", out=tmp_path / "a.rrd")
    with pytest.raises(UnknownNameError, match="unknown episode 'x'"):
        view(data, "x", out=tmp_path / "a.rrd")
    assert not list(tmp_path.glob("*a.rrd*"))


@needs_rerun
def test_a_file_that_cannot_be_written_is_one_error(dataset, scene, tmp_path):
    (tmp_path / "a.rrd").mkdir()
    with pytest.raises(SetupError, match="cannot be written"):
        view(dataset(make_episode(scene)), "e", out=tmp_path / "a.rrd")
    assert not list(tmp_path.glob(".a.rrd*"))


@needs_rerun
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere there is always a display")
def test_without_a_display_a_file_is_proposed(dataset, scene, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SetupError, match=r"--out episode\.rrd"):
        view(dataset(make_episode(scene)), "e")


def test_without_rerun_the_extra_is_named(dataset, scene, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"candata\[view\]"):
        view(dataset(make_episode(scene)), "e", out=tmp_path / "a.rrd")
