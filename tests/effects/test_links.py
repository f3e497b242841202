"""Effects on links: what they change, on which bodies they can act, and that the drives must feel these."""

from __future__ import annotations

import numpy as np
import pytest

from candata.effects import effect, members_of, sensed_at
from candata.errors import UnknownNameError, UsageError
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout
from candata.simulate.world import build_worlds
from tests.effects.pan_tilt import ROLES, XML, write_neck

LINKS = ("link_mass", "link_com", "link_inertia")
#: Gravity [m/s^2].
G = 9.81


@pytest.fixture(scope="module")
def neck(tmp_path_factory):
    return write_neck(tmp_path_factory.mktemp("neck"))


def edited(scene, name: str, element: str | None = None, **parameters):
    """The model with one effect in it."""
    return build_worlds(scene, [(EffectSetting(name=name, element=element, parameters=parameters),)]).models[0]


def test_a_heavier_link_has_another_density(neck):
    model, head = edited(neck, "link_mass", "head", mass_scale=1.5), neck.model.body("head").id
    scale = np.ones(neck.model.nbody)
    scale[head] = 1.5
    assert np.array_equal(model.body_mass, scale * neck.model.body_mass)
    assert np.array_equal(model.body_inertia, scale[:, None] * neck.model.body_inertia)
    # What the solver derives of masses follows.
    assert model.dof_M0[1] - 0.01 == pytest.approx(1.5 * (neck.model.dof_M0[1] - 0.01), rel=1e-9)


def test_all_links_are_the_bodies_that_joints_move(neck):
    model = edited(neck, "link_mass", mass_scale=0.5)
    assert np.array_equal(model.body_mass, 0.5 * neck.model.body_mass)


def test_a_centre_of_mass_moves_in_the_frame_of_its_body(neck):
    model, head = edited(neck, "link_com", "head", offset_m=(0.1, 0.0, -0.02)), neck.model.body("head").id
    assert model.body_ipos[head] - neck.model.body_ipos[head] == pytest.approx([0.1, 0, -0.02])
    assert np.array_equal(model.body_inertia, neck.model.body_inertia)
    # The inertia about the joint follows: m (r + d)^2 for m r^2, and the height.
    mass, r = neck.model.body_mass[head], neck.model.body_ipos[head, 0]
    gain = mass * ((r + 0.1) ** 2 + 0.02**2 - r**2)
    assert model.dof_M0[1] - neck.model.dof_M0[1] == pytest.approx(gain, rel=1e-9)


def test_an_inertia_grows_about_the_centre_of_mass(neck):
    model, head = edited(neck, "link_inertia", "head", inertia_scale=2.0), neck.model.body("head").id
    assert np.array_equal(model.body_mass, neck.model.body_mass)
    assert model.body_inertia[head] == pytest.approx(2 * neck.model.body_inertia[head])
    assert model.dof_M0[1] > neck.model.dof_M0[1]


def test_a_static_sag_grows_with_the_moment(neck):
    """At rest a servo gives way by m g r / kp."""
    worlds = [(), (EffectSetting(name="link_mass", element="head", parameters={"mass_scale": 1.25}),)]
    commands = np.zeros((2, 300, 2))
    q = rollout(neck, commands, *at_rest(neck, 2), worlds).readings["joint_position"][:, -1, 1]
    moment = G * (0.2 * 0.2 + 0.4 * 0.4) * np.cos(q) * np.array([1.0, 1.25])
    assert q == pytest.approx(moment / 25.0, rel=1e-3)


def test_a_link_is_read_at_the_joints_that_feel_it(neck):
    assert sensed_at("link_mass", neck, "head") == ("pan", "nod")
    assert sensed_at("link_mass", neck, "neck") == ("pan",)


@pytest.mark.parametrize("name", LINKS)
def test_links_that_drives_hardly_feel_are_no_cause(name):
    hand = load_scene("xhand_tabletop")
    assert not effect(name).possible(hand)
    with pytest.raises(UsageError, match=f"effect {name} cannot act"):
        edited(hand, name)


def test_a_small_link_is_no_element_beside_heavy_ones(tmp_path):
    """A finger of 5 g on the head: all links together hold it, and nothing else does."""
    finger = '<body name="finger" pos=".4 0 0"><joint name="curl" axis="0 1 0"/><geom size=".01" mass=".005"/></body>'
    xml = XML.replace("</body>", finger + "</body>", 1).replace(
        "</actuator>", '<position name="curl" joint="curl"/></actuator>'
    )
    scene = write_neck(tmp_path, xml, ROLES.replace("nod]", "nod, curl]"))
    assert effect("link_mass").elements(scene) == ("neck", "head")
    heavier = edited(scene, "link_mass", mass_scale=2.0).body("finger").mass
    assert heavier == 2 * scene.model.body("finger").mass


def test_a_wheel_keeps_its_centre(tmp_path):
    """MuJoCo compiles a body whose centre lies on its axis without room for another."""
    wheel = '<body name="wheel"><joint name="wheel"/><geom size=".2" mass="2"/></body></worldbody>'
    xml = XML.replace("</worldbody>", wheel).replace("</actuator>", '<position name="w" joint="wheel"/></actuator>')
    scene = write_neck(tmp_path, xml, ROLES.replace("nod]", "nod, wheel]", 1).replace("nod]", "nod, w]"))
    assert effect("link_mass").elements(scene) == ("neck", "head", "wheel")
    assert effect("link_com").elements(scene) == ("neck", "head")
    model = edited(scene, "link_com", offset_m=(0.05, 0, 0))
    moved = (model.body_ipos != scene.model.body_ipos).any(1)
    assert [model.body(int(b)).name for b in np.flatnonzero(moved)] == ["neck", "head"]


def test_a_group_of_joints_is_its_links(tmp_path):
    wrist = '<body name="wrist" pos=".4 0 0"><joint name="wrist"/><geom pos=".1 0 0" size=".02" mass=".4"/></body>'
    xml = XML.replace("</body>", wrist + "</body>", 1).replace(
        "</actuator>", '<position name="wrist" joint="wrist"/></actuator>'
    )
    roles = ROLES.replace("nod]", "nod, wrist]") + "groups: {outer: [nod, wrist], all: [pan, nod, wrist]}\n"
    scene = write_neck(tmp_path, xml, roles)
    assert effect("link_mass").elements(scene) == ("neck", "head", "wrist", "outer")
    assert members_of("link_mass", scene, "outer") == ("head", "wrist")
    model = edited(scene, "link_mass", "outer", mass_scale=2.0)
    assert [model.body(n).mass[0] / scene.model.body(n).mass[0] for n in ("neck", "head", "wrist")] == [1, 2, 2]


def test_the_object_is_no_link(tmp_path):
    ball = '<body name="ball" pos="1 0 .1"><freejoint/><geom size=".1" mass="1" contype="1"/></body></worldbody>'
    scene = write_neck(tmp_path, XML.replace("</worldbody>", ball), ROLES + "object: ball\n")
    model = edited(scene, "link_mass", mass_scale=2.0)
    assert model.body("ball").mass == scene.model.body("ball").mass
    with pytest.raises(UnknownNameError, match="unknown link or group 'ball'"):
        edited(scene, "link_mass", "ball", mass_scale=2.0)
