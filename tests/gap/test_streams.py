"""What a diagnosis draws depends on what it asks, not on what it asked before, nor on the order of what it is given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap import diagnose
from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidates
from candata.gap.fit.comparison import null_level
from candata.gap.fit.signatures import library
from candata.gap.fit.world_floor import in_world
from candata.gap.run.streams import Streams
from candata.gap.screening.look import look
from candata.gap.validation.closure import shares
from candata.gap.validation.intervals import intervals
from candata.gap.validation.null_test import null_gains
from tests.gap.conftest import members, signatures_of, step_problem


def drawn(*asked, seed: int = 0) -> float:
    return float(Streams(seed).of(*asked).random())


def test_one_question_has_one_stream_that_begins_anew():
    assert drawn("floor", ["e0", "e1"]) == drawn("floor", ["e0", "e1"])


def test_another_name_content_or_seed_is_another_stream(planted):
    mild, clear = (planted("joint_damping", damping_Nms_rad=d) for d in (0.1, 0.2))
    of_one = planted("joint_damping", "elbow", damping_Nms_rad=0.1)
    found = [
        *(drawn("floor"), drawn("fold"), drawn("floor", seed=1), drawn("floor", ())),
        *(drawn("floor", some) for some in (mild, clear, of_one, (*mild, *clear))),
        *(drawn("floor", ids) for ids in (["a", "b"], ["ab"], ["b", "a"])),
    ]
    assert len(set(found)) == len(found)


def test_one_world_is_one_content_in_any_order_and_to_the_digits_that_count(planted):
    damping, delay = planted("joint_damping", damping_Nms_rad=0.2), planted("actuation_delay", delay_s=0.03)
    near = planted("joint_damping", damping_Nms_rad=0.2 + 1e-12)
    assert drawn("floor", (*damping, *delay)) == drawn("floor", (*delay, *damping))
    assert drawn("floor", damping) == drawn("floor", near) == drawn("floor", list(damping))


@pytest.fixture(scope="module")
def problem(arm, arm_episodes, planted):
    """What a damped arm poses, with damping and inertia of joints to search among."""
    recs = recordings(arm, arm_episodes(planted("joint_damping", damping_Nms_rad=0.25), rows=80))
    posed = step_problem(arm, recs)
    names = {c.name for c in candidates(arm, recs.channels)}
    return replace(posed, ruled_out=frozenset(names - {"joint_damping", "armature"}))


def answers(problem, world) -> list[np.ndarray]:
    """Floors, levels, thresholds, null recordings, intervals and shares, of a set and of the nominal world."""
    own, first = in_world(problem, world), look(problem)
    best = first.fits[0]
    return [
        own.score.floor,
        np.array([null_level(own.score), null_level(problem.score), first.threshold]),
        null_gains(problem, (), world, copies=1),
        np.array(intervals(problem, best)),
        np.array(shares(problem, best)[0][:1]),
    ]


def test_a_question_asked_again_has_the_same_answer_whatever_was_asked_between(arm, problem):
    world, other = members(arm, joint_damping=0.2), members(arm, armature=0.01)
    first = answers(problem, world)
    problem.stream("another question").random()
    in_world(problem, other)
    null_gains(problem, (), other, copies=1)
    for one, again in zip(first, answers(replace(problem, played={}), world), strict=True):
        np.testing.assert_array_equal(one, again)


def test_two_worlds_have_nulls_of_their_own(arm, problem):
    """Of nearly one world the floors are nearly the same, by other noise."""
    floors = [in_world(problem, members(arm, joint_damping=d)).score.floor for d in (0.2, 0.2001)]
    assert np.corrcoef(floors)[0, 1] < 0.9
    assert not np.isclose(*floors, rtol=1e-3).any()


def test_what_is_seen_of_an_effect_does_not_depend_on_what_is_asked_with_it(problem, planted):
    some = [planted("armature", armature_kgm2=x) for x in (0.001, 0.002, 0.003)]

    def seen(asked):
        args = (problem.recs, problem.begin, problem.plan, problem.raw, None)
        return signatures_of(library(problem.replayer, *args), asked)

    together = seen(some)
    for one, alone in zip(together, (seen([s])[0] for s in some), strict=True):
        np.testing.assert_array_equal(one, alone)
    for one, back in zip(together, seen(some[::-1])[::-1], strict=True):
        np.testing.assert_array_equal(one, back)


def test_the_order_in_which_episodes_were_written_changes_no_report(arm, arm_episodes, as_dataset, planted):
    episodes = arm_episodes(planted("joint_damping", damping_Nms_rad=0.25), rows=80)
    reports = [
        diagnose(as_dataset(some), arm, only=("joint_damping", "armature")).report
        for some in (episodes, episodes[3:] + episodes[:3][::-1])
    ]
    assert reports[0] == reports[1]
    assert reports[0].effects[0].name == "joint_damping"
