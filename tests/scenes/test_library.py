"""The built-in scenes: kinematics, roles, clouds."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from candata.errors import SceneError
from candata.policies import policy
from candata.scenes import load_scene
from candata.scenes.clouds import surface_cloud
from candata.scenes.contract import SCENES
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


@pytest.mark.parametrize("name", SCENES.names())
def test_a_builtin_scene_keeps_its_contract(name):
    scene = load_scene(name)
    assert scene.model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
    assert scene.file.noise is not None
    assert scene.policies
    assert all(policy(p).possible(scene) for p in scene.policies)
    assert load_scene(name).digest == scene.digest


def test_the_list_says_what_the_scenes_are():
    listed = [(e.name, e.joints, e.actuators, e.fingertips) for e in builtin_scenes()]
    assert [entry[0] for entry in listed] == sorted(SCENES.names())
    assert {("cube_toss", 0, 0, 0), ("gripper_tabletop", 8, 8, 3), ("xhand_tabletop", 15, 15, 5)} <= set(listed)


def test_roles_are_read_from_the_model(hand):
    found = roles(hand)
    assert (found.integrator, found.cone, found.solver) == ("implicitfast", "elliptic", "newton")
    assert found.object_mass_kg == pytest.approx(0.25)
    thumb = next(joint for joint in found.joints if joint.name == "thumb_bend")
    assert (thumb.type, thumb.unit, thumb.group, thumb.actuator) == ("hinge", "rad", "thumb", "thumb_bend")
    assert (thumb.drive, thumb.kp, thumb.kp_unit, thumb.kv_unit) == ("position servo", 3.0, "N m/rad", "N m s/rad")
    assert (thumb.limit, thumb.limit_unit) == (1.1, "N m")
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


def thing(folder, geoms: str):
    """A scene whose object is made of `geoms`, away from the origin and turned."""
    (folder / "scene.xml").write_text(
        '<mujoco><asset><mesh name="tetra" vertex=".03 .03 .03 -.03 -.03 .03 -.03 .03 -.03 .03 -.03 -.03"/>'
        '</asset><worldbody><body name="thing" pos="1 2 3" euler="30 40 50"><freejoint/>'
        f"{geoms}</body></worldbody></mujoco>"
    )
    (folder / "scene.yaml").write_text("model: scene.xml\nrate_hz: 100\nobject: thing\n")
    return load_scene(folder / "scene.yaml")


@pytest.mark.parametrize("kind", ["sphere", "capsule", "ellipsoid", "cylinder"])
def test_a_cloud_lies_on_the_solid_and_is_uniform(tmp_path, kind):
    scene = thing(tmp_path, f'<geom type="{kind}" size=".02 .03 .04"/>')
    x, y, z = surface_cloud(scene, 4000).astype(float).T
    side = np.hypot(x, y)
    on_surface, moments = {
        "sphere": (np.hypot(side, z) - 0.02, 0.02**2 / 3),
        "capsule": (np.hypot(side, np.maximum(np.abs(z) - 0.03, 0)) - 0.02, None),
        "ellipsoid": (np.sqrt((x / 0.02) ** 2 + (y / 0.03) ** 2 + (z / 0.04) ** 2) - 1, None),
        # Share of the side 3/4, spread h^2 / 3 there and h^2 on the lids.
        "cylinder": (
            np.where(side < 0.02 - 1e-6, np.abs(z) - 0.03, side - 0.02),
            0.03**2 * (0.75 / 3 + 0.25),
        ),
    }[kind]
    np.testing.assert_allclose(on_surface, 0, atol=1e-6)
    # The mean of 4000 points is known to about 1 %: 5 % is 4 standard deviations and more.
    assert np.abs([x.mean(), y.mean(), z.mean()]).max() < 0.05 * 0.04
    if moments is not None:
        assert np.mean(z**2) == pytest.approx(moments, rel=0.08)


def test_an_ellipsoid_s_cloud_is_uniform_over_the_area(tmp_path):
    cloud = surface_cloud(thing(tmp_path, '<geom type="ellipsoid" size=".01 .01 .04"/>'), 4000)
    u = np.linspace(-1, 1, 20001)
    # Area element of a spheroid with half axes a, a, c at z = c u: 2 pi a sqrt(a^2 u^2 + c^2 (1 - u^2)) du.
    weight = np.sqrt((0.01 * u) ** 2 + 0.04**2 * (1 - u**2))
    expected = np.average((0.04 * u) ** 2, weights=weight)
    assert np.mean(cloud[:, 2] ** 2) == pytest.approx(expected, rel=0.08)


def test_a_cloud_of_a_mesh_lies_in_its_faces(tmp_path):
    cloud = surface_cloud(thing(tmp_path, '<geom type="mesh" mesh="tetra"/>'))
    # A regular tetrahedron with edge e: inner radius e / (2 sqrt 6), outer e sqrt 6 / 4.
    edge = 0.06 * np.sqrt(2)
    far = np.linalg.norm(cloud, axis=1)
    assert far.min() >= edge / (2 * np.sqrt(6)) - 1e-6
    assert far.max() <= edge * np.sqrt(6) / 4 + 1e-6


def test_a_cloud_covers_all_geoms_by_their_area(tmp_path):
    geoms = '<geom size=".01" pos="-.1 0 0"/><geom size=".02" pos=".1 0 0"/>'
    cloud = surface_cloud(thing(tmp_path, geoms), 2000)
    # Areas as 1 to 4; 2000 draws: 0.2 +- 0.009.
    assert (cloud[:, 0] < 0).mean() == pytest.approx(0.2, abs=0.03)


def test_a_scene_without_an_object_has_no_cloud(tmp_path):
    arm = '<mujoco><worldbody><body><joint name="bend"/><geom size=".1"/></body></worldbody></mujoco>'
    (tmp_path / "scene.xml").write_text(arm)
    (tmp_path / "scene.yaml").write_text("model: scene.xml\nrate_hz: 100\njoints: [bend]\n")
    with pytest.raises(SceneError, match="has no object"):
        surface_cloud(load_scene(tmp_path / "scene.yaml"))


def test_a_scene_is_one_line_and_a_table_of_roles():
    scene = load_scene("gripper_tabletop")
    joints, tips = scene.file.joints, scene.file.fingertips
    assert repr(scene).startswith(f"Scene('gripper_tabletop', {len(joints)} joints, ")
    assert "\n" not in repr(scene)
    html = scene._repr_html_()
    assert ", ".join(joints) in html
    assert ", ".join(tips) in html
