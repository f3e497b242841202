"""Diagnoses that begin where others ended: the nominal simulator holds given effects."""

from __future__ import annotations

import pytest

from candata.simulate import with_effects

KNOWN = {"delay_s": 0.03}
HIDDEN = {"kp_scale": 0.6}
SEARCHED = ("actuation_delay", "servo_gain", "joint_damping")


@pytest.fixture(scope="module")
def recorded(arm_episodes, planted):
    """Episodes of an arm with a delay and soft servos."""
    return arm_episodes((*planted("actuation_delay", **KNOWN), *planted("servo_gain", **HIDDEN)))


def test_what_is_beside_a_given_effect_is_named_and_the_repair_holds_both(arm, planted, recorded, judge):
    given = planted("actuation_delay", **KNOWN)
    diagnosis = judge(with_effects(arm, given), recorded, only=SEARCHED)
    (effect,) = diagnosis.report.effects
    assert (diagnosis.report.verdict, effect.name) == ("explained", "servo_gain")
    assert effect.parameters["kp_scale"].value == pytest.approx(HIDDEN["kp_scale"], rel=0.05), "as noise allows"
    assert diagnosis.report.given_effects == given
    assert diagnosis.effects.effects == (*given, *diagnosis.named)


def test_an_effect_that_is_given_and_named_acts_twice(arm, planted, recorded, judge):
    given = (*planted("actuation_delay", **KNOWN), *planted("servo_gain", kp_scale=0.75))
    diagnosis = judge(with_effects(arm, given), recorded, only=SEARCHED)
    scales = [s.parameters["kp_scale"] for s in diagnosis.effects.effects if s.name == "servo_gain"]
    assert scales[0] == 0.75
    assert scales[0] * scales[1] == pytest.approx(HIDDEN["kp_scale"], rel=0.05), "as noise allows"


def test_no_gap_remains_where_all_that_is_wrong_is_given(arm, planted, recorded, judge):
    given = (*planted("actuation_delay", **KNOWN), *planted("servo_gain", **HIDDEN))
    diagnosis = judge(with_effects(arm, given), recorded, only=SEARCHED)
    assert diagnosis.report.verdict == "no_gap"
    assert (diagnosis.effects.effects, diagnosis.named) == (given, ())
