"""Honest measures: beliefs are scored whether a name is given or not, errors are over what there was to find."""

from __future__ import annotations

from math import log

import pytest

from candata.gap.blind.answers import opened_outcomes
from candata.gap.blind.honesty import LEAST_SUPPORT, all_covered, brier_score, deviation_errors, log_score
from candata.gap.blind.outcomes import Outcome
from candata.gap.blind.runs import Place
from candata.gap.blind.scores import score_run
from candata.schema.bench import CaseResult, Label
from candata.schema.effect import EffectSetting
from candata.schema.report import Estimate, NamedEffect
from tests.gap.outcomes import CONE, MASS, SLIDE, case, say

#: The model's own values of what the cases hide.
OWN = {"object_mass": {"mass_scale": 1.0}, "sliding_friction": {"scale": 1.0}}


def row(outcomes, measure):
    found = score_run(outcomes, scene="s", cases=len(outcomes))
    return next(r for r in found.rows if r.measure == measure)


def test_an_error_is_measured_by_how_far_the_truth_is_from_the_model():
    """A mass scale of 1.5 found as 1.4 misses a fifth of the fault, though it is off by 7 % of the value."""
    right = case("one", (MASS,), (say(MASS, mass_scale=1.4),), nominal=OWN)
    assert deviation_errors(right) == [pytest.approx(0.2)]
    assert row([right], "error over the deviation: median").value == pytest.approx(20)
    nothing_found = case("one", (MASS,), (say(MASS, mass_scale=1.0),), nominal=OWN)
    assert deviation_errors(nothing_found) == [1.0]


def test_a_vector_counts_by_its_length_and_what_has_no_distance_not_at_all():
    bias = EffectSetting(name="pose_bias", parameters={"bias_m": (0.03, -0.04, 0.0)})
    found = NamedEffect(
        name="pose_bias", share=1.0, support=0.9, parameters={"bias_m": Estimate(value=(0.03, -0.04, 0.01))}
    )
    assert deviation_errors(case("one", (bias,), (found,), nominal={"pose_bias": {"bias_m": 0.0}})) == [
        pytest.approx(0.2)
    ]
    as_the_model_has_it = MASS.model_copy(update={"parameters": {"mass_scale": 1.0}})
    for outcome in (
        case("one", (CONE,), (say(CONE),), nominal=OWN),
        case("one", (MASS,), (say(SLIDE),), nominal=OWN),
        case("one", (as_the_model_has_it,), (say(MASS),), nominal=OWN),
    ):
        assert deviation_errors(outcome) == []


def test_intervals_of_wrong_names_are_held_to_the_models_own_value():
    both = case("one", (MASS,), (say(MASS), say(SLIDE)), nominal=OWN)
    assert all_covered(both) == [True, False]
    no_harm = case("one", (MASS,), (say(SLIDE, scale=1.05),), nominal=OWN)
    assert all_covered(no_harm) == [True]
    assert row([both, no_harm], "coverage of 90 % intervals, wrong names too").value == pytest.approx(200 / 3)
    one_sided = NamedEffect(
        name="sliding_friction", share=1.0, support=0.9, parameters={"scale": Estimate(value=0.6, high=0.8)}
    )
    assert all_covered(case("null", (), (one_sided,), nominal=OWN)) == [False]


def test_a_belief_is_scored_by_what_is_so():
    right, wrong = case("one", (MASS,), (say(MASS, 0.8),)), case("one", (MASS,), (say(SLIDE, 0.8),))
    assert brier_score(right) == pytest.approx(0.04)
    assert log_score(right) == pytest.approx(-log(0.8))
    assert brier_score(wrong) == pytest.approx(1 + 0.64)
    assert log_score(wrong) == pytest.approx(-log(LEAST_SUPPORT) - log(0.2))


def test_silence_is_no_way_to_a_good_score():
    silent, null = case("one", (MASS,)), case("null")
    assert (brier_score(silent), brier_score(null)) == (1, 0)
    assert log_score(silent) == pytest.approx(log(100))
    assert row([silent, null], "Brier score of support, silence counted").value == 0.5
    assert "Brier score of support, named effects" not in {
        r.measure for r in score_run([silent, null], scene="s", cases=2).rows
    }
    right = case("one", (MASS,), (say(MASS, 0.8),))
    assert row([silent, right], "Brier score of support, named effects").value == pytest.approx(0.04)


def test_an_ambiguous_class_shares_its_belief():
    tied = case("one", (MASS,), verdict="ambiguous", tied=("object_mass", "sliding_friction"))
    assert brier_score(tied) == pytest.approx(0.5)
    assert log_score(tied) == pytest.approx(-2 * log(0.5))


def test_an_honest_search_scores_better_than_one_that_is_always_sure():
    def said(support):
        return [case("one", (MASS,), (say(MASS if k else SLIDE, support),)) for k in range(4)]

    honest, sure = said(0.75), said(1.0)
    for measure in ("Brier score of support, named effects", "log score of support, named effects"):
        assert row(honest, measure).value < row(sure, measure).value


def test_each_case_keeps_its_own_score_and_a_background_has_none():
    some = [case("one", (MASS,), (say(MASS, 0.8),)), case("null", (), (say(MASS),)), case("background", (MASS,))]
    scores = score_run(some, scene="s", cases=3).scores
    assert [s.right for s in scores] == [True, False, False]
    assert scores[0].brier_score == pytest.approx(0.04)
    assert scores[2].log_score is None


def test_noise_that_is_not_as_declared_has_rows_of_its_own():
    null = case("null", (), (say(MASS),))
    other = Label(case="c", kind="null", noise="undeclared")
    some = [null, Outcome(other, null.result), Outcome(other, case("null").result)]
    assert row(some, "noise undeclared: right").value == 50
    assert (row(some, "noise undeclared, null: an effect named").n, len(some)) == (2, 3)


def test_opened_cases_know_the_models_own_values(tmp_path, cube):
    place = Place(tmp_path / "case-0001", cube.name, "s")
    unheard = NamedEffect(name="of_another_version", share=0.1, support=0.1, parameters={})
    report = case("one", (MASS,), (say(MASS), say(SLIDE), unheard)).result.report
    result = CaseResult(case="case-0001", sealed="s", cpu_s=1.0, cold=False, report=report)
    label = Label(case="case-0001", kind="one", effects=(MASS,))
    (outcome,) = opened_outcomes([place], [result], {"case-0001": label}, {})
    assert outcome.nominal == OWN
