"""The search: true effects are found from wrong beginnings, and no others stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.fit.candidates import candidate
from candata.gap.screening.refinement import joint
from candata.gap.search.agenda import ROUNDS, aliases, begun, search
from tests.gap.conftest import fitted, members, plant

DRY, DELAY = "joint_dry_friction", "actuation_delay"
TWO_CAUSES = (*plant(DRY, frictionloss_Nm=0.3), *plant(DELAY, delay_s=0.03))


def never(world, fit) -> bool:
    """Let nothing end a search."""
    return False


@pytest.fixture(scope="module")
def two(arm_search):
    """The problem of an arm with two causes, and each effect alone."""
    return arm_search(*TWO_CAUSES)


@pytest.fixture(scope="module")
def right(arm, two):
    """A fit of the two true causes."""
    problem, _ = two
    some = members(arm, joint_dry_friction=0.3, actuation_delay=0.03)
    return joint(problem, some, problem.score.loss(problem.nominal))


def on_elbow(arm, name, value):
    return candidate(name, arm, "elbow"), np.full(1, value)


@pytest.mark.parametrize(
    ("begin", "elbow"),
    [
        ({"armature": 0.0005}, {}),
        ({"joint_damping": 0.3, DELAY: 0.03}, {}),
        ({DELAY: 0.03}, {DRY: 0.3}),
        ({DRY: 0.2, DELAY: 0.03, "joint_damping": 0.03}, {}),
        ({DRY: 0.3, "servo_damping": 0.3, "armature": 0.0005}, {}),
    ],
    ids=["no cause", "one that makes up", "one joint's", "an idle third", "two that stand for one"],
)
def test_a_true_pair_is_found_from_a_wrong_beginning(arm, two, begin, elbow):
    problem, alone = two
    start = fitted(problem, (*members(arm, **begin), *(on_elbow(arm, *item) for item in elbow.items())))
    found = search(problem, start, alone, never)
    assert set(start.labels) != {DRY, DELAY}
    assert {c.label: float(u[0]) for c, u in found.incumbent.members} == pytest.approx(
        {DRY: 0.3, DELAY: 0.03}, rel=0.05
    )
    assert not found.remains
    assert found.world is not problem, "in units of the floor of its own world"
    assert found.incumbent.key in found.visited


def test_a_true_set_stays_and_nothing_is_asked_of_it(two, right):
    problem, alone = two
    asked = []
    found = search(problem, right, alone, lambda world, fit: bool(asked.append(fit)))
    assert found.incumbent.key == right.key
    assert not found.remains
    assert asked == []


def test_what_was_measured_stays_though_it_does_nothing(arm, two, right):
    problem, alone = two
    idle = members(arm, servo_gain=0.0)
    start = fitted(problem, (*right.members, *idle))
    found = search(replace(problem, measured=idle), start, alone, never)
    assert set(found.incumbent.labels) == {DRY, DELAY, "servo_gain"}
    assert set(search(problem, start, alone, never).incumbent.labels) == {DRY, DELAY}


def test_a_set_is_begun_with_only_where_it_takes_most_of_what_is_left(arm, two, right):
    problem, alone = two
    first = fitted(problem, members(arm, armature=0.0005))
    assert set(begun(problem, first, alone).labels) == {DRY, DELAY}
    assert begun(problem, first, [response for response in alone if response[0].name not in (DRY, DELAY)]) is None


@pytest.mark.parametrize("ended", [True, False])
def test_what_leaves_a_gap_is_asked_about_before_more_is_looked_at(arm, two, ended):
    """With the second cause ruled out, little else helps."""
    problem, _ = two
    only = replace(problem, ruled_out=problem.ruled_out | {DRY, "joint_damping", "servo_damping", "servo_gain"})
    asked = []

    def ends(world, fit) -> bool:
        asked.append(fit.key)
        return ended

    found = search(only, fitted(only, members(arm, actuation_delay=0.03)), (), ends)
    assert found.remains
    assert any(DELAY in label for label in found.incumbent.labels)
    assert asked[-1] == found.incumbent.key if ended else asked
    assert len(set(asked)) == len(asked) < ROUNDS
    assert not {c.name for fit in found.visited.values() for c, _ in fit.members} & only.ruled_out


def test_a_null_keeps_what_it_begins_with_and_looks_no_further(arm, arm_search):
    problem, alone = arm_search()
    start = fitted(problem, members(arm, servo_gain=0.001))
    found = search(problem, start, alone, never)
    assert found.incumbent.key == start.key
    assert not found.remains


def test_a_fault_of_one_joint_is_told_from_that_of_all_beside_another(arm, arm_search):
    truth = {f"{DELAY} elbow": 0.03, "joint_damping": 0.3}
    problem, alone = arm_search(*plant("joint_damping", damping_Nms_rad=0.3), *plant(DELAY, "elbow", delay_s=0.03))
    found = search(problem, fitted(problem, members(arm, actuation_delay=0.03)), alone, never)
    assert {c.label: float(u[0]) for c, u in found.incumbent.members} == pytest.approx(truth, rel=0.05)


def test_a_choice_is_found_beside_another_effect(arm, arm_search):
    problem, alone = arm_search(*plant("time_step", time_step_s=0.005), *plant(DRY, frictionloss_Nm=0.3))
    found = search(problem, fitted(problem, members(arm, joint_dry_friction=0.3)), alone, never)
    truth = {DRY: 0.3, "time_step": np.log(0.005)}
    assert {c.label: float(u[0]) for c, u in found.incumbent.members} == pytest.approx(truth, rel=0.02)


@pytest.mark.parametrize(("share", "open_"), [(0.0005, True), (0.05, False)])
def test_an_alias_that_leaves_hardly_more_leaves_open_which_it_is(arm, two, right, share, open_):
    problem, _ = two
    now = float(problem.score.loss(right.plane.z).mean())
    worth = float(problem.score.loss(problem.without_each(right.members)[0]).mean()) - now
    evidence = replace(right.evidence, loss=right.evidence.loss + share * worth)
    rival = replace(right, members=(*members(arm, joint_damping=0.3), right.members[1]), evidence=evidence)
    found = aliases(problem, right, [rival])
    assert [f.labels[0] for f in found] == ([DRY, "joint_damping"] if open_ else [])
    assert aliases(problem, right, []) == []


def test_an_alias_of_what_is_worth_little_leaves_the_others_named(arm, two, right):
    problem, _ = two
    some = fitted(problem, (*right.members, *members(arm, armature=1e-6)))
    rival = replace(some, members=(*some.members[:2], *members(arm, servo_gain=1e-6)))
    assert aliases(problem, some, [rival]) == []
