"""What the player is given is what the episode holds, thinned and small."""

from __future__ import annotations

import base64
import json

import mujoco
import numpy as np
import pytest
import trimesh

from candata.datasets import append, create_dataset, open_dataset, put_cloud
from candata.errors import UsageError
from candata.reports.playback import EPISODE_BYTES, NO_VALUE, Playbacks, safe_json
from candata.reports.solids import simplified, solids
from candata.scenes import load_scene
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage


def unpacked(record):
    numbers = np.frombuffer(base64.b64decode(record["data"]), "<i2").astype(float)
    return np.where(numbers == NO_VALUE, np.nan, record["low"] + record["step"] * numbers)


@pytest.fixture
def made(tmp_path):
    def make(*episodes, cloud=None):
        root = create_dataset(tmp_path / "ds")
        if cloud is not None:
            put_cloud(root, cloud)
        append(root, list(episodes), Lineage(operation="test"))
        return open_dataset(root)

    return make


@pytest.fixture(scope="module")
def gripper():
    return load_scene("gripper_tabletop")


def gripped(scene, rows=50, **meta):
    """An episode of the gripper whose object climbs 1 mm a row."""
    count = len(scene.file.joints)
    pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (rows, 1))
    pose[:, 2] = 1e-3 * np.arange(rows)
    arrays = {
        "time_ns": np.arange(rows) * 12_500_000,
        "object_pose": pose,
        "joint_position": np.zeros((rows, count)),
        "fingertip_force": np.zeros((rows, len(scene.file.fingertips), 3)),
    }
    fields = {
        "id": "e",
        "source": "sim",
        "rate_hz": 80.0,
        "joint_names": scene.file.joints,
        "scene": "gripper_tabletop",
    }
    return Episode(EpisodeMeta.model_validate(fields | meta), arrays)


def test_bodies_are_where_the_scene_puts_them(made, gripper):
    data = made(gripped(gripper))
    playbacks = Playbacks(data)
    playbacks.add(data[0])
    record = json.loads(playbacks.episodes["e"])
    (geometry,) = playbacks.geometries.values()
    bodies = json.loads(geometry)["bodies"]
    position = unpacked(record["frames"]["position"]).reshape(50, len(bodies), 3)
    climbs = np.isclose(position[-1, :, 2] - position[0, :, 2], 0.049, atol=1e-4)
    assert climbs.sum() == 1, "the object moves"
    assert not bodies[int(np.flatnonzero(climbs)[0])]["still"]
    assert any(body["still"] for body in bodies), "the table stands"
    assert record["notes"] == []


def test_long_episodes_and_many_bodies_stay_small(made, gripper):
    data = made(gripped(gripper, rows=20_000))
    playbacks = Playbacks(data)
    playbacks.add(data[0])
    assert len(playbacks.episodes["e"]) < EPISODE_BYTES
    record = json.loads(playbacks.episodes["e"])
    assert record["frames"]["time"][-1] == pytest.approx(data[0].time_s[-1], abs=1e-3)
    assert f"{len(record['frames']['time'])} of 20,000 rows are kept" in record["notes"][0]


def test_a_spike_survives_and_an_invalid_row_is_a_gap(made, episode):
    rows = 5000
    values = np.zeros((rows, 2))
    values[1234, 0] = 7.0
    valid = np.arange(rows) < 4000
    base = episode("e", rows=rows)
    values[~valid] = np.nan
    data = made(Episode(base.meta, {**base.arrays, "joint_position": values, "joint_position_valid": valid}))
    playbacks = Playbacks(data)
    playbacks.add(data[0])
    record = json.loads(playbacks.episodes["e"])
    lane = next(lane for lane in record["lanes"] if lane["title"] == "joint position")
    line = unpacked(lane["lines"][0])
    assert np.nanmax(line) == pytest.approx(7, abs=1e-3)
    assert np.isnan(line[-1])
    assert "joint_position is not valid in 1,000 of 5,000 rows." in record["notes"]


def test_without_a_scene_the_object_is_its_cloud(made, episode, rng):
    cloud = rng.normal(size=(2000, 3)).astype(np.float32)
    root_cloud = made(episode("other"), cloud=cloud)
    name = next((root_cloud.path / "objects").glob("*.parquet")).stem
    append(root_cloud.path, [episode("e", scene=None, point_cloud=name)], Lineage(operation="test"))
    data = open_dataset(root_cloud.path)
    playbacks = Playbacks(data)
    playbacks.add(data["e"])
    assert "The hand is not drawn: the recordings name no scene" in playbacks.episodes["e"]
    (body,) = json.loads(playbacks.geometries[name])["bodies"]
    points = unpacked(body["points"]).reshape(-1, 3)
    assert len(points) == 400
    assert np.abs(points[0] - cloud[0]).max() < 1e-3


def test_a_given_scene_must_be_that_of_the_hand(made, episode):
    data = made(episode("e"))
    with pytest.raises(UsageError, match="the episode's joints are not those of the scene"):
        Playbacks(data, "gripper_tabletop").add(data[0])


def test_text_cannot_end_the_script():
    assert "<" not in safe_json({"id": "</script><script>"})
    assert json.loads(safe_json({"id": "</script>"})) == {"id": "</script>"}


def test_solids_fill_the_space_of_their_geoms():
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body name="b">
      <geom type="box" size=".1 .2 .3" pos="1 0 0"/> <geom type="capsule" size=".05" fromto="0 0 0 0 0 1"/>
      <geom type="sphere" size=".1" rgba="1 0 0 0"/> <geom type="cylinder" size=".1 .2" euler="90 0 0"/>
      </body></worldbody></mujoco>""")
    box, capsule, cylinder = solids(model, model.body("b").id)
    np.testing.assert_allclose([box.vertices.min(0), box.vertices.max(0)], [[0.9, -0.2, -0.3], [1.1, 0.2, 0.3]])
    np.testing.assert_allclose([capsule.vertices[:, 2].min(), capsule.vertices[:, 2].max()], [-0.05, 1.05], atol=1e-6)
    np.testing.assert_allclose(np.abs(cylinder.vertices[:, 1]).max(), 0.2, atol=1e-9)


def test_faces_that_turn_away_are_left_out_of_closed_solids_alone():
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody>
      <geom type="box" size=".1 .2 .3"/> <geom type="capsule" size=".05 .1"/> <geom size=".1"/>
      <geom type="cylinder" size=".1 .2"/> <geom type="plane" size="1 1 1"/> <geom size=".1" rgba="1 0 0 .5"/>
      </worldbody></mujoco>""")
    assert [solid.is_closed for solid in solids(model, 0)] == [True] * 4 + [False] * 2


def test_a_mesh_keeps_its_shape_with_few_triangles():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    vertices, faces = simplified(np.array(ball.vertices), np.array(ball.faces), 300)
    assert 50 < len(faces) <= 300
    radii = np.linalg.norm(vertices[np.unique(faces)], axis=1)
    assert 0.085 < radii.min() <= radii.max() < 0.101
