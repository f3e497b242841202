"""The built-in scenes: kinematics, roles, clouds."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from candata.errors import SceneError
from candata.plugins import names
from candata.policies import policy
from candata.scenes import load_scene
from candata.scenes.assemble import LIBRARY
from candata.scenes.clouds import surface_cloud
from candata.scenes.roles import builtin_scenes, roles

#: Fingertips at zero in the palm's frame [mm] (public XHand1 wiki of PNDbotics).
TIPS_MM = {
    "thumb_rota2": (22.1, 156.8, 28.7),
    "index2": (6.5, 26.5, 205.7),
    "mid2": (6.5, 4.0, 206.2),
    "ring2": (6.5, -16.0, 203.2),
    "pinky2": (6.5, -36.0, 200.2),
}
#: The frames sit at the centres of the caps, a capsule's radius before the ends.
CAP_MM = 8.0
#: Total mass [kg] (same source).
HAND_KG = 1.10


@pytest.fixture(scope="module")
def hand():
    return load_scene("xhand_tabletop")


@pytest.mark.parametrize("tip", TIPS_MM)
def test_a_fingertip_at_zero_is_where_the_table_says(hand, tip):
    model = hand.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palm = data.body("palm")
    turn = palm.xmat.reshape(3, 3).T
    site, body = data.site(f"{tip}_frame").xpos, data.body(tip).xpos
    end = site + CAP_MM * 1e-3 * (site - body) / np.linalg.norm(site - body)
    # The table is rounded to 0.1 mm, and so are the origins that are chained here.
    np.testing.assert_allclose(1e3 * turn @ (end - palm.xpos), TIPS_MM[tip], atol=0.2)


def test_the_hand_weighs_what_the_maker_says(hand):
    palm = hand.model.body("palm").id
    assert hand.model.body_subtreemass[palm] == pytest.approx(HAND_KG, rel=0.03)


@pytest.mark.parametrize("name", names(LIBRARY))
def test_a_builtin_scene_keeps_its_contract(name):
    scene = load_scene(name)
    assert scene.model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
    assert scene.file.noise is not None
    assert scene.policies
    assert all(policy(p).possible(scene) for p in scene.policies)
    assert load_scene(name).digest == scene.digest


def test_the_list_says_what_the_scenes_are():
    assert [(e.name, e.joints, e.actuators, e.fingertips) for e in builtin_scenes()] == [
        ("cube_toss", 0, 0, 0),
        ("xhand_tabletop", 15, 15, 5),
    ]


def test_roles_are_read_from_the_model(hand):
    found = roles(hand)
    assert (found.integrator, found.cone, found.solver) == ("implicitfast", "elliptic", "newton")
    assert found.object_mass_kg == pytest.approx(0.25)
    thumb = next(joint for joint in found.joints if joint.name == "thumb_bend")
    assert (thumb.type, thumb.unit, thumb.group, thumb.actuator) == ("hinge", "rad", "fingers", "thumb_bend")
    assert (thumb.kp, thumb.limit) == (3.0, 1.1)
    assert found.fingertips[1].frame == "site index2_frame"


def test_a_cloud_lies_on_the_surface_and_repeats():
    scene = load_scene("cube_toss")
    cloud = surface_cloud(scene)
    half = 0.1048 / 2
    assert cloud.shape == (512, 3)
    np.testing.assert_allclose(np.abs(cloud).max(1), half, atol=1e-6)
    # Six equal faces: 85 points each, give or take 4 standard deviations.
    face = np.argmax(np.abs(cloud), 1) * 2 + (cloud[np.arange(512), np.argmax(np.abs(cloud), 1)] > 0)
    assert np.abs(np.bincount(face, minlength=6) - 512 / 6).max() < 4 * np.sqrt(512 * 5 / 36)
    assert np.array_equal(cloud, surface_cloud(scene))
    assert not np.array_equal(cloud, surface_cloud(scene, seed=1))


@pytest.mark.parametrize(
    ("geom", "reach"),
    [
        ('type="sphere" size=".03"', 0.03),
        ('type="capsule" size=".01 .03"', 0.04),
        ('type="ellipsoid" size=".01 .02 .03"', 0.03),
        ('type="cylinder" size=".03 .01"', np.hypot(0.03, 0.01)),
        ('type="mesh" mesh="tetra"', 0.03 * np.sqrt(3)),
    ],
)
def test_a_cloud_of_any_solid_is_in_the_object_s_frame(tmp_path, geom, reach):
    (tmp_path / "scene.xml").write_text(
        '<mujoco><asset><mesh name="tetra" vertex=".03 .03 .03 -.03 -.03 .03 -.03 .03 -.03 .03 -.03 -.03"/>'
        '</asset><worldbody><body name="thing" pos="1 2 3" euler="30 40 50"><freejoint/>'
        f"<geom {geom}/></body></worldbody></mujoco>"
    )
    (tmp_path / "scene.yaml").write_text("model: scene.xml\nrate_hz: 100\nobject: thing\n")
    cloud = surface_cloud(load_scene(tmp_path / "scene.yaml"))
    far = np.linalg.norm(cloud, axis=1).max()
    # 512 random points come close to the farthest one; facets cut at most 2 % off round shapes.
    assert 0.75 * reach < far <= reach * (1 + 1e-6)


def test_a_scene_without_an_object_has_no_cloud(tmp_path):
    (tmp_path / "scene.xml").write_text("<mujoco><worldbody/></mujoco>")
    (tmp_path / "scene.yaml").write_text("model: scene.xml\nrate_hz: 100\n")
    with pytest.raises(SceneError, match="has no object"):
        surface_cloud(load_scene(tmp_path / "scene.yaml"))
