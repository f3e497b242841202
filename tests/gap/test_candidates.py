"""Candidates: effects as vectors of coordinates, inside their bounds, with an absence to compare with."""

from __future__ import annotations

import numpy as np
import pytest

from candata.effects import effect, effect_names, flatten
from candata.gap.fit.candidates import (
    candidate,
    candidates,
    first_probes,
    local_candidates,
    on_slides,
    probes,
    typical_size,
)
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting

CHANNELS = ("joint_position", "object_pose", "fingertip_force")


def possible(scene) -> list[str]:
    return [n for n in effect_names() if effect(n).possible(scene)]


def test_every_effect_that_can_act_is_a_candidate(arm, hand, cube):
    for scene in (arm, hand, cube):
        assert [c.name for c in candidates(scene, CHANNELS)] == possible(scene)


def test_a_sensing_effect_is_no_candidate_where_its_channel_was_not_recorded(hand):
    some = {c.name for c in candidates(hand, ("joint_position",))}
    assert set(possible(hand)) - some == {
        n for n in possible(hand) if effect(n).moves and "joint_position" not in effect(n).moves
    }
    assert "tactile_gain" not in some


@pytest.mark.parametrize("name", effect_names())
def test_the_neutral_point_is_the_effect_s_absence(hand, name):
    c = candidate(name, hand)
    assert c.size == len(flatten(EffectSetting(name=name), hand))
    if not c.choices:
        identity = flatten(EffectSetting(name=name), hand)
        known = np.isfinite(identity)
        # Through a logarithm and back: rounding.
        np.testing.assert_allclose(c.values(c.neutral)[known], identity[known], rtol=1e-12, atol=1e-15)
    assert ((c.low <= c.neutral) & (c.neutral <= c.high)).all()


@pytest.mark.parametrize("name", effect_names())
def test_probes_lie_within_bounds_and_off_the_neutral_point(hand, name):
    c = candidate(name, hand)
    points = probes(c, hand)
    assert len(points) >= c.size
    for u in points:
        assert ((c.low - 1e-12 <= u) & (u <= c.high + 1e-12)).all()
        assert (u != c.neutral).sum() == 1, "one coordinate at a time"
        assert c.setting(u, hand).name == name


def test_coordinates_outside_the_bounds_are_brought_back(hand):
    c = candidate("joint_damping", hand)
    low, high = effect("joint_damping").parameters[0].bounds(hand)
    assert c.values(np.array([-1e3])) == pytest.approx(low)
    assert c.values(np.array([1e3])) == pytest.approx(high)


def test_half_and_double_are_equally_far(hand):
    c = candidate("object_mass", hand)
    assert c.logarithmic.all()
    half, double = (u[0] for u in probes(c, hand) if round(float(c.values(u)[0]), 9) in (0.5, 2.0))
    assert half + double == pytest.approx(2 * c.neutral[0], abs=1e-12)


@pytest.mark.parametrize("name", effect_names())
def test_a_first_look_is_near_and_far_on_each_side_that_a_scalar_has(hand, name):
    c = candidate(name, hand)
    everywhere, first = (np.array([u for u in f(c, hand)]) for f in (probes, first_probes))
    if c.choices:
        assert np.array_equal(everywhere, first)
        return
    if c.size > 1:
        # every number of a vector moves alone: once, or of few numbers to both sides
        moved = first - c.neutral
        assert ((moved != 0).sum(1) == 1).all()
        sides = [{*np.sign(column[column != 0])} for column in moved.T]
        assert len(first) == sum(len(s) for s in sides)
        both = [{-1.0, 1.0} if c.low[i] < c.neutral[i] else {1.0} for i in range(c.size)]
        assert sides == both if c.size <= 3 else all(len(s) == 1 for s in sides)
        return
    away = everywhere[:, 0] - c.neutral[0]
    for side in {*np.sign(away)}:
        mine = np.sort(np.abs(away[np.sign(away) == side]))
        seen = np.sort(np.abs((first[:, 0] - c.neutral[0])[np.sign(first[:, 0] - c.neutral[0]) == side]))
        assert len(seen) == (len(mine) if len(mine) <= 3 else 3)
        assert (seen[0], seen[-1]) == (mine[0], mine[-1])


def test_a_first_look_at_one_element_leaves_out_the_nearest_of_many(hand):
    elements = [v for v in local_candidates(candidate("torque_limit", hand), hand) if len(probes(v, hand)) > 3]
    assert elements
    for v in elements:
        away, seen = (sorted(abs(float(u[0] - v.neutral[0])) for u in f(v, hand)) for f in (probes, first_probes))
        assert seen == [away[(len(away) - 1) // 2], away[-1]]


@pytest.mark.parametrize("name", effect_names())
def test_probes_reach_what_is_plausible(hand, name):
    c = candidate(name, hand)
    if c.size > 1 or c.choices:
        return
    (parameter,) = effect(name).parameters
    drawn = np.array(parameter.draws(hand))
    values = np.array([c.values(u)[0] for u in probes(c, hand)])
    room = 0.11 * (drawn.max() - drawn.min())
    assert values.max() >= min(drawn.max(), float(c.values(c.high)[0])) - room
    assert values.min() <= max(drawn.min(), float(c.values(c.low)[0])) + room


@pytest.mark.parametrize("name", effect_names())
def test_a_plausible_size_lies_within_the_bounds(hand, name):
    c = candidate(name, hand)
    if c.choices or not effect(name).parameters[0].draws(hand):
        return
    size = typical_size(c, hand)
    assert size.shape == c.neutral.shape
    assert ((size > 0) & (size < c.high - c.low)).all()


def test_a_label_names_the_element(hand):
    assert candidate("joint_damping", hand).label == "joint_damping"
    assert candidate("joint_damping", hand, "index2").label == "joint_damping index2"
    assert candidate("joint_damping", hand, "index2").setting(np.array([0.1]), hand).element == "index2"


@pytest.mark.parametrize("name", effect_names())
def test_a_local_variant_acts_on_its_element_alone(hand, name):
    whole = candidate(name, hand)
    variants = local_candidates(whole, hand)
    elements = effect(name).elements(hand)
    assert [c.element for c in variants] == (list(elements) if len(elements) > 1 else [])
    for c in variants:
        points = probes(c, hand)
        assert points
        for u in points:
            setting = c.setting(u, hand)
            assert setting.element == c.element
            flatten(setting, hand)  # within bounds, of the right size
        assert local_candidates(c, hand) == [], "an element has no elements"


def test_only_a_group_that_an_effect_spares_is_on_slides(hand, arm):
    assert [v.label for v in on_slides(candidate("servo_gain", hand), hand)] == ["servo_gain wrist"]
    assert on_slides(candidate("joint_damping", hand), hand) == []
    assert on_slides(candidate("servo_gain", hand, "index"), hand) == []
    assert on_slides(candidate("servo_gain", arm), arm) == []


def test_one_number_of_a_vector_is_searched_to_both_sides(hand):
    c = candidate("joint_offset", hand, "index2")
    assert c.size == 1
    assert {float(np.sign(u[0])) for u in probes(c, hand)} == {-1.0, 1.0}
    x = flatten(c.setting(np.array([0.02]), hand), hand)
    assert (x != 0).sum() == 1


def test_contacts_given_stiffer_than_two_steps_are_searched_from_there_on(tmp_path):
    """MuJoCo takes a time constant of 0.1 ms for 4 ms where it steps by 2 ms; both neutral value and probes say so."""
    (tmp_path / "scene.xml").write_text(
        '<mujoco><option timestep="0.002"/><default><geom solref="0.0001 1"/></default><worldbody>'
        '<geom name="floor" type="plane" size="1 1 .1"/><body name="box" pos="0 0 .1"><freejoint/>'
        '<geom type="box" size=".02 .02 .02"/></body></worldbody></mujoco>'
    )
    (tmp_path / "scene.yaml").write_text("model: scene.xml\nrate_hz: 100\nobject: box\nsupport: floor\n")
    c = candidate("contact_compliance", scene := load_scene(tmp_path / "scene.yaml"))
    assert c.values(c.neutral) == pytest.approx([0.004])
    found = np.exp(np.concatenate(probes(c, scene)))
    assert found.min() > 0.005
    assert found.max() >= 0.02
    assert len(set(found.tolist())) == len(found)
