"""Moves: what all of them keep to, and where each leads."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.fit.candidates import candidate
from candata.gap.fit.fits import Fit, key_of
from candata.gap.moves import MOVES
from candata.gap.moves._view import View
from candata.gap.moves.split import SHARES
from candata.gap.screening.episodes import brief
from candata.scenes import load_scene
from tests.gap.conftest import fitted, members, plant

TRUE = ("actuation_delay", "joint_dry_friction")
TWO_CAUSES = (*plant("joint_dry_friction", frictionloss_Nm=0.3), *plant("actuation_delay", delay_s=0.03))


@pytest.fixture(scope="module")
def seen(arm_search):
    """The function that shows a set to a move, of an arm with two causes."""
    problem, alone = arm_search(*TWO_CAUSES)
    part, index = brief(problem)

    def show(some, remains: bool = True, measured=()) -> View:
        own = replace(problem, measured=measured)
        fit = some if isinstance(some, Fit) else fitted(problem, some)
        return View(own, own, replace(part, measured=measured), index, fit, alone, remains)

    return show


@pytest.fixture(scope="module")
def sets(arm, seen):
    """Fitted sets: one effect, two, and two of which one is of one joint and one a choice."""
    step = candidate("time_step", arm)
    elbow = (candidate("joint_damping", arm, "elbow"), np.array([0.2]))
    some = (
        members(arm, actuation_delay=0.03),
        members(arm, joint_damping=0.3, actuation_delay=0.03),
        (elbow, (step, step.low)),
    )
    return [seen(begun).fit for begun in some]


def labels(some) -> tuple[str, ...]:
    return tuple(c.label for c, _ in some)


@pytest.mark.parametrize("name", sorted(MOVES))
def test_a_move_proposes_other_sets_of_known_effects_within_bounds_and_simulates_few_episodes(arm, seen, sets, name):
    proposed = []
    for fit in sets:
        view = seen(fit)
        few = set(zip(view.part.recs.ids, view.part.begin.keys, strict=True))
        before = set(view.root.played)
        found = list(MOVES[name](view))
        assert {key for _, key in set(view.root.played) - before} <= few, "only the few episodes are simulated"
        proposed += [(fit, some) for some in found]
    assert proposed
    for fit, some in proposed:
        assert key_of(some) != fit.key or labels(some) != fit.labels
        assert len({c.name for c, _ in some}) == len(some), "no effect twice"
        for c, u in some:
            assert candidate(c.name, arm, c.element).label == c.label
            assert u.shape == (c.size,)
            assert (c.low <= u).all()
            assert (u <= c.high).all()


@pytest.mark.parametrize("name", sorted(MOVES))
def test_a_move_proposes_the_same_of_the_same_set(seen, sets, name):
    fit = sets[0] if name in ("pair", "split") else sets[1]
    once, again = ([(labels(s), [u.tolist() for _, u in s]) for s in MOVES[name](seen(fit))] for _ in range(2))
    assert once == again


@pytest.mark.parametrize("name", ["add", "pair", "split"])
def test_nothing_comes_to_a_set_that_leaves_nothing(seen, sets, name):
    assert list(MOVES[name](seen(sets[0]))) != []
    assert list(MOVES[name](seen(sets[0], remains=False))) == []


@pytest.mark.parametrize("name", ["add", "split"])
def test_nothing_comes_to_a_full_set_but_beside_what_was_measured(arm, seen, name):
    full = members(arm, actuation_delay=0.03, joint_damping=0.1, armature=0.001)
    assert list(MOVES[name](seen(full))) == []
    assert list(MOVES[name](seen(full, measured=full[:1]))) != []


@pytest.mark.parametrize("name", ["exchange", "drop", "place", "split"])
def test_what_was_measured_stays_in_the_set(seen, sets, name):
    delay = sets[1].members[1]
    found = [labels(some) for some in MOVES[name](seen(sets[1], measured=(delay,)))]
    assert found
    assert all("actuation_delay" in some for some in found)


def test_add_promises_most_of_the_effect_that_is_missing(seen, sets):
    first, *_ = MOVES["add"](seen(sets[0]))
    assert labels(first) == TRUE
    assert first[0][1] == pytest.approx([0.03], rel=0.2)


def test_pair_begins_with_all_that_the_recording_adds_up_to(arm, seen):
    found = list(MOVES["pair"](seen(members(arm, armature=0.0005))))
    assert set(labels(found[0])) == set(TRUE)
    assert {len(some) for some in found} == {2, 3}
    assert list(MOVES["pair"](seen(members(arm, armature=0.0005, servo_gain=0.1)))) == []


def test_split_shares_what_a_member_explains_with_an_effect_that_does_much_alike(arm_search, arm):
    effects = (*plant("servo_damping", kv_scale=3.0), *plant("joint_damping", damping_Nms_rad=0.4))
    problem, alone = arm_search(*effects)
    part, index = brief(problem)
    view = View(problem, problem, part, index, fitted(problem, members(arm, servo_damping=1.5)), alone, True)
    ((_, u),) = view.members
    found = [some for some in MOVES["split"](view) if labels(some) == ("servo_damping", "joint_damping")]
    assert len(found) == len(SHARES)
    for (_, own), (_, rest) in found:
        assert 0 < own[0] < u[0], "less than it is alone"
        assert rest[0] > 0


def test_exchange_puts_the_true_effect_in_the_place_of_one_that_made_up_for_it(seen, sets):
    first, *_ = (some for some in MOVES["exchange"](seen(sets[1])) if "actuation_delay" in labels(some))
    assert set(labels(first)) == set(TRUE)


def test_drop_leaves_out_each_member(seen, sets):
    found = [labels(some) for some in MOVES["drop"](seen(sets[1]))]
    assert sorted(found) == [("actuation_delay",), ("joint_damping",)]
    assert list(MOVES["drop"](seen(sets[0]))) == []


@pytest.mark.parametrize(
    ("name", "element", "numbers", "label", "there"),
    [
        ("torque_limit", "thumb_base", [0.19], "torque_limit thumb", [0.19]),
        ("torque_limit", "thumb_base", [0.19], "torque_limit", [0.19]),
        ("torque_limit", None, [0.19], "torque_limit thumb_base", [0.19]),
        ("sliding_friction", "left_tip", [-0.7], "sliding_friction fingertips", [-0.7]),
        ("joint_offset", None, [0.01, 0.02, 0.03, 0.04, 0.05, 0.06], "joint_offset thumb_end", [0.06]),
    ],
)
def test_place_keeps_the_value_of_an_effect_on_other_elements(name, element, numbers, label, there):
    scene = load_scene("gripper_tabletop")
    problem = SimpleNamespace(replayer=SimpleNamespace(scene=scene), measured=())
    other, own = (
        (candidate("object_mass", scene), np.array([0.4])),
        (candidate(name, scene, element), np.array(numbers)),
    )
    view = View(problem, problem, problem, np.arange(1), Fit((own, other), None, None), (), True)
    found = {labels(some)[0]: some for some in MOVES["place"](view)}
    assert found[label][0][1].tolist() == there
    assert found[label][1] is other
    assert own[0].label not in found
