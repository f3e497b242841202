"""Another object in a scene: it stands where the old one stood, touches what that touched, and clears the hand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh

from candata.errors import SceneError, UsageError
from candata.policies._drive import holding_commands
from candata.scenes import load_scene
from candata.scenes.clouds import surface_cloud
from candata.scenes.object_making import ObjectSource, make_object
from candata.simulate import at_rest, rollout

#: A brick with a small end, off the origin of its file [m], and its mass [kg].
SIDES, OFFSET, MASS = (0.04, 0.03, 0.07), np.array([0.05, -0.02, 0.1]), 0.3


@pytest.fixture(scope="module")
def brick(tmp_path_factory):
    """The folder of an object whose origin is far from it."""
    folder = tmp_path_factory.mktemp("objects")
    trimesh.creation.box(SIDES).apply_translation(OFFSET).export(folder / "brick.stl")
    make_object(ObjectSource(folder / "brick.stl", "brick", MASS), folder / "brick", drops=20)
    return folder / "brick"


def named_geoms(scene):
    return {scene.model.geom(g).name: scene.model.geom(g) for g in range(scene.model.ngeom)}


@pytest.mark.parametrize("base", ["xhand_tabletop", "gripper_tabletop", "cube_toss"])
def test_it_rests_with_its_mass_where_the_old_one_stood(base, brick):
    plain, scene = load_scene(base), load_scene(f"{base}+{brick}")
    assert scene.file == plain.file
    assert scene.policies == plain.policies
    assert scene.model.body_mass[scene.object_id] == pytest.approx(MASS)
    qpos, qvel = at_rest(scene, 1)
    rest_command = holding_commands(scene, scene.model.actuator_length0[scene.actuator_ids])
    commands = np.repeat(rest_command[None, None], round(scene.file.rate_hz), axis=1)
    ended = rollout(scene, commands, qpos, qvel, [()], keep_state=True).qpos[0, -1]
    at = scene.object_qpos
    # A second later it has only sunk into the soft contact, by less than a millimetre.
    np.testing.assert_allclose(ended[at : at + 7], qpos[0, at : at + 7], atol=1e-3)
    places = []
    for world in (plain, scene):
        data = mujoco.MjData(world.model)
        mujoco.mj_forward(world.model, data)
        places.append(data.xipos[world.object_id, :2].copy())
    np.testing.assert_allclose(*places, atol=1e-4)
    # It stands on its small end: half its height over the table.
    assert data.xipos[scene.object_id, 2] == pytest.approx(SIDES[2] / 2, abs=1e-3)


def test_its_pieces_touch_what_the_old_geoms_touched(brick):
    plain, scene = load_scene("xhand_tabletop"), load_scene(f"xhand_tabletop+{brick}")
    pieces = [scene.model.geom(g) for g in scene.object_geoms]
    old = [plain.model.geom(name) for name in ("object", "object_foot")]
    for piece, geom in zip(pieces, old, strict=True):
        assert (piece.contype, piece.conaffinity, piece.condim) == (geom.contype, geom.conaffinity, geom.condim)
        np.testing.assert_array_equal(piece.friction, geom.friction)
    assert "object_mark" not in named_geoms(scene)
    assert np.abs(surface_cloud(scene) - OFFSET).max() == pytest.approx(SIDES[2] / 2, abs=1e-4)


def test_its_digest_does_not_depend_on_where_its_folder_lies(brick, tmp_path):
    moved = tmp_path / "elsewhere"
    moved.symlink_to(brick)
    digests = {load_scene(f"cube_toss+{folder}").digest for folder in (brick, moved)}
    assert len(digests) == 1
    assert load_scene("cube_toss").digest not in digests


def test_keyframes_have_it_where_it_stands(brick):
    scene = load_scene(f"xhand_tabletop+{brick}")
    at = scene.object_qpos
    for key in range(scene.model.nkey):
        np.testing.assert_array_equal(scene.model.key_qpos[key, at : at + 7], scene.model.qpos0[at : at + 7])


#: A post that stands a little to one side of the object, on a slide; it reaches over the table.
ROBOT = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="1 1 .1"/>
  <body pos="{x} 0 {z}"><joint name="post" type="slide" axis="1 0 0"/><geom type="box" size="{half} .1 .2"/></body>
  <body name="box" pos="0 0 .03"><freejoint/><geom name="box" size=".03"/>{more}</body>
</worldbody>{tail}</mujoco>
"""
ROLES = "model: scene.xml\nrate_hz: 100\nobject: box\njoints: [post]\n"


def scene_of(folder, x=1.0, z=0.25, half=0.005, more="", tail="", roles="support: floor\n"):
    """A user's scene with a post beside its object, or above it."""
    (folder / "scene.xml").write_text(ROBOT.format(x=x, z=z, half=half, more=more, tail=tail))
    (folder / "scene.yaml").write_text(ROLES + roles)
    return folder / "scene.yaml"


def test_it_turns_where_the_robot_is_in_its_way(tmp_path, brick):
    # Of the upright brick, 0.04 m wide and 0.03 m deep, 0.02 m reach towards the post, or 0.015 m when turned.
    attitudes = [load_scene(f"{scene_of(tmp_path, x)}+{brick}").model.qpos0[-4:] for x in (0.026, 0.0225)]
    np.testing.assert_allclose(attitudes[0], [1, 0, 0, 0], atol=1e-3)
    np.testing.assert_allclose(attitudes[1], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-3)


def test_it_lies_where_there_is_no_room_above(tmp_path, brick):
    # The ceiling is 0.05 m over the floor: the brick is 0.07 m high.
    scene = load_scene(f"{scene_of(tmp_path, x=0.0, z=0.25, half=0.2)}+{brick}")
    data = mujoco.MjData(scene.model)
    mujoco.mj_kinematics(scene.model, data)
    assert data.xipos[scene.object_id, 2] < 0.025


@pytest.mark.parametrize(
    ("of", "words"),
    [
        ({"x": 0.0, "z": 0.21, "half": 0.2}, "does not fit"),
        ({"roles": ""}, "no support"),
        ({"more": '<body name="lid"><geom size=".001"/></body>'}, "carries lid"),
        ({"tail": '<contact><pair geom1="floor" geom2="box"/></contact>'}, "contact pairs name its geoms"),
    ],
)
def test_a_scene_that_cannot_hold_it_says_why(tmp_path, brick, of, words):
    with pytest.raises(SceneError, match=words):
        load_scene(f"{scene_of(tmp_path, **of)}+{brick}")


def test_an_object_or_scene_that_is_not_known_is_said():
    with pytest.raises(UsageError, match="unknown object 'no_such'"):
        load_scene("cube_toss+no_such")
    with pytest.raises(UsageError, match="unknown scene 'no_such'"):
        load_scene("no_such+can")
