"""The score: each measure counts what it says, misses are named, nothing is scored against what was only drawn."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.blind.misses import miss
from candata.gap.blind.outcomes import Outcome, covered, parameter_error
from candata.gap.blind.scores import calibration, confusion, score_run
from candata.schema.bench import CaseResult, FilledSignature, Label, OutsideCause
from candata.schema.effect import EffectSetting
from candata.schema.report import Estimate, NamedEffect, RankedEffect, UnknownCause
from tests.gap.outcomes import CONE, DRY, MASS, SLIDE, case, say


def row(outcomes, measure):
    found = score_run(outcomes, scene="s", cases=len(outcomes))
    return next(r for r in found.rows if r.measure == measure)


def test_first_counts_what_is_named_first_and_in_three_what_is_ranked():
    third = tuple(RankedEffect(name=n, support=0.1, held_out_gain=0.1) for n in ("a", "b", "object_mass"))
    fourth = tuple(RankedEffect(name=n, support=0.1, held_out_gain=0.1) for n in ("a", "b", "c", "object_mass"))
    some = [
        case("one", (MASS,), (say(MASS),)),
        case("one", (MASS,), (say(SLIDE), say(MASS))),
        case("one", (MASS,), verdict="unknown_effect", ranking=third),
        case("one", (MASS,), verdict="unknown_effect", ranking=fourth),
    ]
    assert row(some, "one effect: first").value == 25
    assert row(some, "one effect: in three").value == 75
    assert row(some, "one effect: and nothing else").value == 25


def test_the_right_name_on_the_wrong_element_is_not_first():
    wrong = DRY.model_copy(update={"element": "ring1"})
    some = [case("local", (DRY,), (say(DRY),)), case("local", (DRY,), (say(wrong),))]
    assert row(some, "local fault: effect and element first").value == 50
    assert row(some, "local fault: the right joint or finger first").value == 50


def test_another_effect_on_the_right_joint_counts_for_where_alone():
    damping = EffectSetting(name="joint_damping", element="index2", parameters={"damping_Nms_rad": 0.1})
    some = [case("local", (DRY,), (say(damping),))]
    assert row(some, "local fault: the right joint or finger first").value == 100
    assert row(some, "local fault: effect and element first").value == 0


def test_a_class_counts_for_where_if_all_of_it_acts_on_the_right_joint():
    same = case("local", (DRY,), verdict="ambiguous", tied=("joint_damping index2", "joint_dry_friction index2"))
    other = case("local", (DRY,), verdict="ambiguous", tied=("joint_damping ring1", "joint_dry_friction index2"))
    assert row([same], "local fault: the right joint or finger first").value == 100
    assert row([other], "local fault: the right joint or finger first").value == 0
    assert row([same], "local fault: effect and element first").value == 0


def test_what_hardly_shows_is_counted_in_the_whole_and_left_out_of_what_is_plain():
    seen = case("one", (MASS,), (say(MASS),), rises={"object_mass": 0.4})
    faint = case("one", (MASS,), rises={"object_mass": 0.01})
    assert row([seen, faint], "one effect: first").value == 50
    assert row([seen, faint], "one effect: first, where it is worth 0.1 floors").value == 100
    assert "object_mass is worth 0.01 floors" in miss(faint).why


def test_parameter_error_is_relative_and_of_rightly_named_effects_only():
    near, far = case("one", (MASS,), (say(MASS, mass_scale=1.53),)), case("one", (MASS,), (say(SLIDE),))
    assert parameter_error(near) == pytest.approx(0.02)
    assert parameter_error(far) is None
    assert row([near, far], "parameter error: median").n == 1


def test_a_choice_has_neither_error_nor_interval():
    right = case("one", (CONE,), (say(CONE),))
    assert parameter_error(right) is None
    assert covered(right) == []


def test_coverage_counts_every_number_of_a_vector():
    bias = EffectSetting(name="pose_bias", parameters={"bias_m": (0.01, -0.01, 0.0)})
    estimate = Estimate(value=(0.01, -0.01, 0.004), low=(0.009, -0.011, 0.003), high=(0.011, -0.009, 0.005))
    found = NamedEffect(name="pose_bias", share=1.0, support=0.9, parameters={"bias_m": estimate})
    assert covered(case("one", (bias,), (found,))) == [True, True, False]


@pytest.mark.parametrize(
    ("ends", "inside"), [({"low": 1.2}, True), ({"low": 1.6}, False), ({"high": 1.6}, True), ({"high": 1.2}, False)]
)
def test_a_range_of_one_end_holds_all_beyond_it(ends, inside):
    found = NamedEffect(
        name="object_mass", share=1.0, support=0.9, parameters={"mass_scale": Estimate(value=1.4, **ends)}
    )
    assert covered(case("one", (MASS,), (found,))) == [inside]


def test_sets_are_right_when_all_are_named_and_nothing_else():
    both, extra, missing = (MASS, SLIDE), (say(MASS), say(SLIDE), say(CONE)), (say(MASS),)
    some = [case("pair", both, named) for named in ((say(SLIDE), say(MASS)), extra, missing)]
    assert row(some, "two effects: all right").value == pytest.approx(100 / 3)
    assert row(some, "two effects: a wrong name").value == pytest.approx(100 / 3)


def test_first_is_scored_against_the_true_shares_not_against_what_was_drawn():
    rises = {"object_mass": 0.2, "sliding_friction": 1.7}
    right = case("background", (MASS, SLIDE), (say(SLIDE),), rises=rises, main="object_mass")
    drawn = case("background", (MASS, SLIDE), (say(MASS),), rises=rises, main="object_mass")
    assert row([right, drawn], "all 5 % wrong + one: largest true contributor first").value == 50
    assert row([right], "all 5 % wrong + one: the drawn one first").value == 0


def test_abstention_is_a_verdict_and_not_silence():
    wind = OutsideCause(name="wind", acts_on="object")
    flagged = {"verdict": "unknown_effect", "outside": wind}
    some = [
        case("outside", unknown=UnknownCause(acts_on="object", words="w"), **flagged),
        case("outside", unknown=UnknownCause(acts_on="joint", words="w"), **flagged),
        case("outside", outside=wind),
        case("outside", named=(say(MASS),), outside=wind),
    ]
    assert row(some, "outside the library: abstains").value == 50
    assert row(some, "outside the library: where it acts is right").value == 25
    whys = [m.why for o in some if (m := miss(o))]
    assert whys == ["said to act on joint, acts on object", "overlooked", "explained by the library"]


def test_a_spent_budget_abstains():
    wind = OutsideCause(name="wind", acts_on="object")
    place = UnknownCause(acts_on="object", words="w")
    some = [
        case("outside", verdict="out_of_budget", unknown=place, outside=wind),
        case("null", verdict="out_of_budget"),
        case("one", (MASS,), verdict="out_of_budget"),
    ]
    assert row(some, "outside the library: abstains").value == 100
    assert row(some, "outside the library: where it acts is right").value == 100
    assert row(some, "null: an effect named").value == 0
    assert row(some, "library effects: false abstention").value == 100
    assert [miss(o).why if miss(o) else None for o in some] == [None, None, "not first"]


def test_nulls_and_false_abstention():
    some = [case("null"), case("null", named=(say(MASS),)), case("one", (MASS,), verdict="unknown_effect")]
    assert row(some, "null: an effect named").value == 50
    assert row(some, "library effects: false abstention").value == 100


def test_a_solver_mismatch_is_found_in_a_class_or_flagged():
    some = [
        case("solver", (CONE,), (say(CONE),)),
        case("solver", (CONE,), verdict="ambiguous", tied=("friction_cone", "impratio")),
        case("solver", (CONE, MASS), (say(MASS),), verdict="partly_explained", unknown=UnknownCause(words="w")),
        case("solver", (CONE, MASS), (say(SLIDE),)),
    ]
    assert row(some, "solver mismatch: found or flagged").value == 75
    assert row(some, "solver mismatch: 50 % mass error on top, first or second").value == 50


def test_calibration_error_of_an_honest_and_of_a_boastful_method():
    rng = np.random.default_rng(1)

    def told(support, right):
        return case("one", (MASS,), (say(MASS if right else SLIDE, support=support),))

    stated = rng.uniform(0.4, 1.0, 400)
    honest = [told(s, rng.random() < s) for s in stated]
    boastful = [told(1.0, i % 2 == 0) for i in range(50)]
    assert len(calibration(honest)) == 5
    assert {b.n for b in calibration(honest)} == {80}
    # Five bins of 80 draws each are off by some 0.04 by chance.
    assert row(honest, "calibration error of support").value < 0.08
    assert row(boastful, "calibration error of support").value == pytest.approx(0.5)


def test_rows_below_target_come_first_and_misses_say_truth_verdict_and_name():
    some = [case("one", (MASS,), (say(SLIDE),)), case("null")]
    found = score_run(some, scene="s", cases=9)
    met = [r.is_met for r in found.rows]
    assert met == sorted(met, key=lambda m: {False: 0, True: 1, None: 2}[m])
    assert met[0] is False
    (missed,) = found.misses
    assert (missed.truth, missed.verdict, missed.named, missed.gap) == (
        "object_mass",
        "explained",
        "sliding_friction",
        3.0,
    )
    assert (found.done, found.cases) == (2, 9)


def test_a_miss_of_a_set_says_what_is_faint_and_what_looks_alike():
    rises = {"object_mass": 2.0, "sliding_friction": 0.02}
    missed = miss(case("pair", (MASS, SLIDE), (say(MASS),), rises=rises, alike=0.93))
    assert missed is not None
    assert missed.why == "not all named; sliding_friction is worth 0.02 floors; two look alike, cosine 0.93"


def test_the_confusion_matrix_counts_first_names_or_verdicts():
    some = [case("one", (MASS,), (say(SLIDE),)), case("quarter", (MASS,)), case("null")]
    assert confusion(some) == {"none": {"no_gap": 1}, "object_mass": {"sliding_friction": 1, "no_gap": 1}}


def test_a_failed_diagnosis_is_a_miss_with_its_reason():
    label = Label(case="case-0001", kind="null")
    outcome = Outcome(label, CaseResult(case="case-0001", sealed="", cpu_s=1.0, cold=False, error="nothing to compare"))
    missed = miss(outcome)
    assert missed is not None
    assert (missed.verdict, missed.why) == ("error", "nothing to compare")


def test_first_cases_are_timed_apart():
    some = [case("null", cpu_s=90.0, cold=True), case("null", cpu_s=12.0)]
    assert row(some, "CPU s of a first case: median").value == 90
    assert row(some, "CPU s a case, cached signatures: median").value == 12


def test_what_was_kept_before_is_summed_once_for_all():
    found = score_run(
        [case("null")], scene="x", cases=1, filled=[FilledSignature(cpu_s=2.0), FilledSignature(cpu_s=3.5)]
    )
    (told,) = [r for r in found.rows if r.measure.startswith("CPU s of the signatures kept before")]
    assert (told.value, told.n, told.is_met) == (5.5, 2, None)
