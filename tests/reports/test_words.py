"""What the report says in words."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest

from candata import reports
from candata.reports import words
from candata.reports.advice import NO_RESPONSE
from candata.reports.numbers import digits, format_estimate, percent, unit_of
from candata.reports.outcome import belief_note, outcome
from candata.schema.report import Estimate, Symptom, Verdict

VERDICTS = get_args(Verdict)


@pytest.mark.parametrize(
    ("verdict", "named", "said"),
    [
        ("partly_explained", {"joint_damping": 0.08, "impratio": 0.09}, ("at most 9 %", "contact law or solver")),
        ("partly_explained", {"joint_damping": 0.08}, ("at most 8 %",)),
        ("partly_explained", {"joint_damping": 0.6, "impratio": 0.09}, ()),
        ("explained", {"joint_damping": 0.08}, ()),
    ],
)
def test_names_that_are_hardly_believed_are_said_to_stand_in(make_report, verdict, named, said):
    """Another engine with nothing changed was partly explained by three names with supports of 0.07 to 0.09."""
    effects = [{"name": name, "share": 0.5, "support": support, "parameters": {}} for name, support in named.items()]
    report = make_report(verdict, effects=effects)
    note = belief_note(report)
    assert bool(note) == bool(said)
    assert all(words in note for words in said)
    assert ("solver" in note) == (len(said) == 2)
    assert note in " ".join(reports.summary(report).split())


@pytest.mark.parametrize("verdict", VERDICTS)
def test_each_verdict_has_one_sentence(verdict):
    sentence = reports.explain(verdict)
    assert sentence.endswith(".")
    assert sentence.count(". ") == 0


@pytest.mark.parametrize(
    ("verdict", "sentence"),
    [
        (
            "explained",
            "Joint dry friction on index2 explains the gap; with it the mismatch falls from 3.12 times the noise floor "
            "to 1.04.",
        ),
        (
            "partly_explained",
            "Joint dry friction on index2 explains 48 % of the gap; with it the mismatch falls from 3.12 times the "
            "noise floor to 2.1, and something else remains.",
        ),
        (
            "ambiguous",
            "Joint damping and joint dry friction explain the gap equally well, so none is named; the mismatch is 3.12 "
            "times the noise floor.",
        ),
        (
            "unknown_effect",
            "No effect of the library explains the gap; the mismatch stays at 3.12 times the noise floor.",
        ),
        (
            "no_gap",
            "The simulation is right as far as the noise of the sensors lets one see: the mismatch is 1.02 times the "
            "noise floor.",
        ),
        (
            "too_little_data",
            "5 episodes are too few to judge an effect on recordings that took no part in its fit: 8 are needed.",
        ),
        (
            "out_of_budget",
            "The CPU time was spent before the search ended, so no effect is named; the mismatch is 3.12 times the "
            "noise floor.",
        ),
    ],
)
def test_the_first_sentence_says_what_happened_in_this_case(make_report, verdict, sentence):
    report = make_report(verdict)
    assert outcome(report) == sentence
    assert " ".join(reports.summary(report).split()).startswith(f"{verdict}: {sentence}")


def test_against_a_reference_the_first_sentence_speaks_of_what_changed(make_report):
    data = make_report().data.model_copy(update={"against": "yesterday@1"})
    text = " ".join(reports.summary(make_report(data=data)).split())
    assert text.startswith("explained: Joint dry friction on index2 explains what changed since yesterday@1; with it")
    assert "does not count" in text


def test_several_effects_explain_together(make_report):
    effect = make_report().effects[0]
    report = make_report(effects=[effect, effect.model_copy(update={"name": "backlash"})])
    assert outcome(report).startswith(
        "Joint dry friction on index2 and backlash on index2 explain the gap; with them the mismatch falls"
    )


@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_summary_has_the_columns_of_a_terminal(make_report, verdict):
    lines = reports.summary(make_report(verdict)).splitlines()
    assert max(len(line) for line in lines if not line.startswith("  candata ")) <= 80


def test_an_interval_that_rounds_to_one_number_is_no_range(make_report):
    gap = {"before": 1.85, "after": 0.98, "closed": 1.0, "low": 1.0, "high": 1.0}
    text = " ".join(reports.summary(make_report(gap=gap)).split())
    assert "90 % interval 100 % at both ends" in text


def test_summary_names_parameter_interval_and_unit(make_report):
    text = " ".join(reports.summary(make_report()).split())
    assert "joint_dry_friction on index2: frictionloss_Nm 0.0412 N m (90 % interval 0.0373 to 0.0458)" in text
    assert "closes 98 % of the gap on held-out episodes (90 % interval 95 to 99 %)" in text
    assert "17.3 times the floor (p = 0.001)" in text


@pytest.mark.parametrize(("ends", "word"), [({"low": 0.0819}, "at least"), ({"high": 0.0884}, "at most")])
def test_what_is_known_from_one_side_is_said_so(make_report, ends, word):
    """In the terminal, in the sentences, and as what is not known; not twice of what stopped at its bound."""
    effect = {
        "name": "joint_dry_friction",
        "element": "index2",
        "share": 1.0,
        "support": 0.9,
        "parameters": {"frictionloss_Nm": {"value": 0.0875, **ends}},
    }
    (end,) = ends.values()
    equally_good = {"at least": "more", "at most": "less"}[word]
    report = make_report(effects=[effect])
    text = " ".join(reports.summary(report).split())
    assert f"frictionloss_Nm {word} {end} N m (0.0875 taken; {equally_good} explains as well); share" in text
    assert f"frictionloss {word} {end} N m" in words.cause_sentence(report)
    assert f"is known from one side: with any {equally_good} the simulation" in words.unknowns_sentence(report)
    bound_report = make_report(effects=[effect | {"at_bound": True}])
    assert "one side" not in words.unknowns_sentence(bound_report)
    assert "stopped at its bound" in words.unknowns_sentence(bound_report)


def test_the_longest_summary_cuts_nothing(make_report):
    """Everything that can be said at once, each of it long."""
    long_text = " ".join(f"word{k}" for k in range(120))
    effect = {
        "name": "tactile_bias",
        "element": "index_tip",
        "share": 0.1,
        "support": 0.5,
        "at_bound": True,
        "parameters": {"bias_N": {"value": [0.1] * 15, "low": [0.05] * 15, "high": [0.15] * 15}},
    }
    unresponsive = [{"name": f"effect_{k}", "support": 0, "held_out_gain": 0, "reason": NO_RESPONSE} for k in range(30)]
    data = make_report().data.model_dump() | {"notes": [long_text], "channels": ["joint_position"], "floor": "assumed"}
    report = make_report(
        "partly_explained",
        effects=[effect | {"element": f"tip{k}"} for k in range(9)],
        unknown={"words": long_text},
        data=data,
        ranking=[*make_report().model_dump()["ranking"], *unresponsive],
        next_motion={"name": "slow", "file": "motion.parquet", "separates": ["a", "b"], "reason": long_text},
    )
    lines = reports.summary(report).splitlines()
    text = " ".join(" ".join(lines).split())
    assert max(len(line) for line in lines if not line.startswith("  candata ")) <= 80
    assert text.count(long_text) == 2
    assert text.count(long_text[1:]) == 3, "the reason begins with a capital"
    assert text.count("tactile_bias on tip") == 9
    assert "30 effects move nothing in these motions" in text


def test_the_summarys_commands_stand_on_lines_of_their_own(make_report):
    context = reports.ReportContext(Path("out/report"), mjcf_lines=('<joint name="index2"/>',))
    lines = reports.summary(make_report(), context).splitlines()
    assert "  candata scene export --effects out/report/effects.yaml --out repaired_model" in lines
    ambiguous_text = " ".join(reports.summary(make_report("ambiguous"), context).split())
    assert "Record slow reversals (out/report/motion.parquet)" in ambiguous_text


def test_a_summary_says_what_to_change(make_report):
    text = " ".join(reports.summary(make_report()).split())
    assert "change Add joint dry friction of 0.0412 N m (0.0373 to 0.0458) to joint index2; in MJCF: add 0.0412" in text


def test_ambiguous_names_nothing_but_the_class_and_the_next_motion(make_report):
    report = make_report("ambiguous")
    assert (
        words.cause_sentence(report) == "Joint damping or joint dry friction: these recordings cannot tell them apart."
    )
    expected = "Record slow reversals (motion.parquet): it separates joint damping from joint dry friction."
    assert words.next_motion_sentence(report) == expected


def test_a_tied_candidate_keeps_the_name_of_its_joint(make_report):
    labels = ("joint_damping left_base", "servo_gain")
    report = make_report("ambiguous").model_copy(update={"ambiguous_class": labels})
    assert words.cause_headline(report) == "Joint damping on left_base or servo gain"
    assert outcome(report).startswith("Joint damping on left_base and servo gain explain the gap equally well")


def test_unknown_effect_offers_the_nearest_only_as_nearest(make_report):
    assert "the nearest is joint dry friction on index2" in words.cause_sentence(make_report("unknown_effect"))


def test_out_of_budget_names_nothing_and_says_what_is_first_so_far(make_report):
    report = make_report("out_of_budget")
    assert words.cause_sentence(report) == (
        "None is named: the search was not finished; first so far is joint dry friction on index2."
    )
    assert words.closure_sentence(report).startswith("On held-out episodes the mismatch is 3.12 times the floor")
    empty_report = report.model_copy(update={"gap": None, "where": (), "ranking": ()})
    assert words.cause_sentence(empty_report) == "None is named: the search was not finished."
    assert words.where_sentence(empty_report) == "Not examined: the budget was spent before."
    assert words.closure_sentence(empty_report) == "Not measured."
    assert "change     Nothing yet: diagnose again with a larger --budget." in reports.summary(empty_report)


def test_where_no_candidate_passes_none_is_said_to_close_anything(make_report):
    report = make_report("unknown_effect")
    unchanged_gap = report.gap.model_copy(update={"after": report.gap.before, "closed": 0.0})
    assert words.closure_sentence(report).startswith("The best candidate would close")
    assert words.closure_sentence(report.model_copy(update={"gap": unchanged_gap})) == (
        f"No candidate passes the held-out test: the mismatch stays at {digits(unchanged_gap.before)} times the floor."
    )


def test_few_episodes_that_hold_most_of_what_remains_are_named(make_report):
    report = make_report("partly_explained")
    outlier_gap = report.gap.model_copy(update={"closed": 0.14, "outlying": ("e2", "e12"), "closed_elsewhere": 0.56})
    sentence = words.closure_sentence(report.model_copy(update={"gap": outlier_gap}))
    assert sentence.endswith("Episodes e2 and e12 hold most of what remains; 56 % of the gap of the others closes.")
    many_outliers = report.model_copy(
        update={"gap": outlier_gap.model_copy(update={"outlying": ("e1", "e2", "e3", "e4")})}
    )
    assert "4 episodes (e1, e2, e3 and others) hold most of what remains" in words.closure_sentence(many_outliers)
    one_outlier = report.model_copy(update={"gap": outlier_gap.model_copy(update={"outlying": ("e2",)})})
    assert "Episode e2 holds most of what remains" in words.closure_sentence(one_outlier)


def test_a_column_of_the_pose_is_said_as_what_it_is():
    symptom = Symptom(channel="object_pose", element="rotation x", phase="rest", ratio=30.0, p=0.001)
    assert words.symptom_place(symptom) == "the object's rotation x during rest"


def test_no_gap_claims_no_repair(make_report):
    text = reports.summary(make_report("no_gap"))
    assert "closes" not in text
    assert "No channel leaves the range" in text


def test_an_assumed_floor_and_a_bound_are_said(make_report):
    report = make_report()
    bound_effect = report.effects[0].model_copy(update={"at_bound": True})
    data = report.data.model_copy(update={"floor": "assumed"})
    text = words.unknowns_sentence(report.model_copy(update={"effects": (bound_effect,), "data": data}))
    assert "stopped at its bound" in text
    assert "floor is assumed" in text


def test_what_may_be_the_cause_instead_is_said(make_report):
    report = make_report()
    effect = report.effects[0].model_copy(update={"rivals": ("pose_scale", "support_height")})
    text = words.unknowns_sentence(report.model_copy(update={"effects": (effect,)}))
    assert "may be pose scale or support height instead" in text
    assert "instead" not in words.unknowns_sentence(report)


@pytest.mark.parametrize(
    ("effect", "parameter", "unit"),
    [
        ("actuation_delay", "delay_s", "s"),
        ("joint_damping", "damping_Nms_rad", "N m s/rad"),
        ("no_such", "ppm", "ppm"),
        ("no_such", "x_Nm", "N m"),
        ("no_such", "x_N", "N"),
        ("no_such", "x_kgm2", "kg m^2"),
        ("no_such", "scale", "1"),
    ],
)
def test_a_parameters_unit(effect, parameter, unit):
    assert unit_of(effect, parameter) == unit


@pytest.mark.parametrize(
    ("estimate", "unit", "text"),
    [
        (Estimate(value=0.0125, low=0.0119, high=0.0131), "s", "12.5 ms (90 % interval 11.9 to 13.1)"),
        (Estimate(value=(0.0, 0.0, 0.015)), "m", "[0, 0, 15] mm"),
        (Estimate(value="elliptic"), "1", "elliptic"),
        (Estimate(value=1.35, low=1.2, high=1.5), "1", "1.35 (90 % interval 1.2 to 1.5)"),
        (Estimate(value=0.0875, low=0.0819), "N m", "at least 0.0819 N m (0.0875 taken; more explains as well)"),
        (Estimate(value=0.004, high=0.005), "s", "at most 5 ms (4 taken; less explains as well)"),
        (Estimate(value=1.5, low=1.2), "1", "at least 1.2 (1.5 taken; more explains as well)"),
        (Estimate(value=0.0), "rad", "0 rad"),
        (Estimate(value=float("nan")), "N", "? N"),
        (
            Estimate(value=(0.01, 0.02), low=(0.0, 0.01), high=(0.02, 0.03)),
            "N",
            "[0.01, 0.02] N (90 % interval [0 to 0.02, 0.01 to 0.03])",
        ),
    ],
)
def test_an_estimate_as_text(estimate, unit, text):
    assert str(format_estimate(estimate, unit)) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(1234.5, "1,230"), (0.04123, "0.0412"), (-2.0, "-2"), (1.5e-7, "1.50e-7"), (99.96, "100")],
)
def test_digits(value, text):
    assert digits(value) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.98, "98 %"), (0.996, "99.6 %"), (1.0, "100 %"), (-0.12, "-12 %"), (0.9999, "99.9 %")],
)
def test_percent_never_rounds_up_to_all(share, text):
    assert percent(share) == text


@pytest.mark.parametrize(
    ("regime", "text"),
    [
        (None, "joint position of index2 during the onset of contact"),
        ("reversal", "joint position of index2 during the onset of contact, above all where it turns back"),
        ("moving -", "joint position of index2 during the onset of contact, above all while it moves down (-)"),
        ("loaded", "joint position of index2 during the onset of contact"),
        ("pulling", "joint position of index2 during the onset of contact, above all where its motor pulls"),
    ],
)
def test_a_symptom_says_its_regime_only_where_it_has_one(regime, text):
    effect = Symptom(channel="joint_position", element="index2", phase="onset", regime=regime, ratio=3.0, p=0.01)
    assert words.symptom_place(effect) == text
