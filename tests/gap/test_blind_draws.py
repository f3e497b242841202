"""What a blind case hides: every name comes, sizes are what their kind says, nothing is the model's own."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from candata.effects import effect, effect_names, effects_with, flatten
from candata.gap.blind.draws import (
    COUNTS,
    background,
    draw_labels,
    draw_setting,
    neutral,
    possible_effects,
    weakened,
)
from candata.schema.effect import EffectSetting


@pytest.fixture(scope="module")
def labels(hand):
    return draw_labels(hand, {k: 48 for k in COUNTS}, np.random.default_rng(1))


def of(labels, kind):
    return [one for one in labels if one.kind == kind]


def test_every_possible_effect_is_drawn_about_as_often_as_the_others(hand, labels):
    counts = Counter(one.effects[0].name for one in of(labels, "one"))
    assert set(counts) == set(possible_effects(hand))
    assert max(counts.values()) - min(counts.values()) <= 1


def test_cases_are_numbered_in_random_order_and_each_has_its_own_noise(labels):
    assert [one.case for one in labels] == [f"case-{i + 1:04d}" for i in range(len(labels))]
    assert len({one.seed for one in labels}) == len(labels)
    assert len({one.kind for one in labels[:20]}) > 4


def test_the_same_secret_draws_the_same_labels_and_another_does_not(hand):
    first, again, other = (draw_labels(hand, {"one": 5}, np.random.default_rng(s)) for s in (1, 1, 2))
    assert first == again != other


@pytest.mark.parametrize("name", [n for n in effect_names() if effect(n).parameters[0].choices])
def test_a_choice_is_never_the_models_own(hand, name):
    rng, parameter = np.random.default_rng(0), effect(name).parameters[0]
    drawn = {draw_setting(hand, name, rng).parameters[parameter.name] for _ in range(20)}
    assert parameter.choices[int(neutral(name, hand)[0])] not in drawn


def test_a_quarter_lies_a_quarter_of_the_way_in_the_logarithm_for_scales(hand):
    heavy = EffectSetting(name="object_mass", parameters={"mass_scale": 2.0})
    assert weakened(hand, heavy, 0.25).parameters["mass_scale"] == pytest.approx(2**0.25)


def test_a_quarter_lies_a_quarter_of_the_way_for_what_the_model_lacks(hand):
    off = EffectSetting(name="object_com", parameters={"offset_m": (0.01, 0.0, -0.008)})
    assert weakened(hand, off, 0.25).parameters["offset_m"] == pytest.approx((0.0025, 0.0, -0.002))


def test_a_quarter_of_what_no_contact_resists_with_is_a_quarter_of_its_value(hand):
    """The least friction that the simulator takes stands for none: from there a logarithm would count 4e-5."""
    rolls = EffectSetting(name="rolling_friction", parameters={"rolling_m": 0.004})
    assert weakened(hand, rolls, 0.25).parameters["rolling_m"] == pytest.approx(0.001, rel=0.01)


def test_a_background_holds_a_little_of_what_no_contact_resists_with(hand):
    """A twentieth of a clear fault, not of the least friction that the simulator takes."""
    drawn = [background(hand, np.random.default_rng(seed), "") for seed in range(5)]
    rolls = [e.parameters["rolling_m"] for some in drawn for e in some if e.name == "rolling_friction"]
    assert len(rolls) == 5
    assert 2e-5 < max(rolls) < 5e-4


def test_pairs_and_triples_have_distinct_names(labels):
    for kind, count in (("pair", 2), ("triple", 3)):
        assert all(len({e.name for e in one.effects}) == count for one in of(labels, kind))


def test_a_local_fault_names_an_element_that_the_effect_has(hand, labels):
    for one in of(labels, "local"):
        assert one.effects[0].element in effect(one.effects[0].name).elements(hand)


def test_the_element_of_a_vector_is_clearly_off(hand):
    rng = np.random.default_rng(3)
    for _ in range(20):
        x = flatten(draw_setting(hand, "tactile_bias", rng, "thumb_rota2"), hand)
        # Half of the farthest that can be drawn, 0.4 N.
        assert np.abs(x).max() >= 0.2


def test_a_background_is_about_five_percent_off_everywhere_but_in_its_main_effect(hand, labels):
    scales = [
        e.parameters["mass_scale"]
        for one in of(labels, "background")
        for e in one.effects
        if e.name == "object_mass" and one.main != "object_mass"
    ]
    # A normal 5 % over some 39 draws: its spread is known to about a ninth (1 / sqrt(2 n)), three of these are allowed.
    assert np.std(np.log(scales)) == pytest.approx(0.05, rel=0.35)
    for one in of(labels, "background"):
        assert one.effects[0].name == one.main
        assert len({e.name for e in one.effects}) == len(one.effects) > 8


def test_half_of_the_solver_cases_have_the_wrong_mass_on_top(labels):
    found = of(labels, "solver")
    assert {one.effects[0].name for one in found} <= set(effects_with("solver"))
    heavy = [one for one in found if len(one.effects) > 1]
    assert len(heavy) == len(found) // 2
    assert all(one.effects[1].parameters == {"mass_scale": 1.5} for one in heavy)


def test_outside_causes_are_of_at_least_six_kinds_and_no_library_effect(labels):
    names = {one.outside.name for one in of(labels, "outside")}
    assert len(names) >= 6
    assert not names & set(effect_names())


def test_a_scene_without_elements_or_object_draws_what_it_can(arm):
    found = draw_labels(arm, {"one": 10, "outside": 6, "solver": 4}, np.random.default_rng(1))
    assert {one.outside.acts_on for one in of(found, "outside")} == {"joint"}
    assert all(len(one.effects) == 1 for one in of(found, "solver"))


def test_a_mixture_of_noise_takes_turns_in_each_kind_and_changes_nothing_else_that_is_drawn(hand):
    counts = {"one": 3, "null": 6}
    mixed = draw_labels(hand, counts, np.random.default_rng(1), noise="mixed")
    for kind, count in counts.items():
        assert set(Counter(label.noise for label in of(mixed, kind)).values()) == {count // 3}
    factors = [label.noise_factor for label in mixed if label.noise == "misdeclared"]
    assert all(0.5 <= factor <= 2 for factor in factors)
    assert len(set(factors)) == 3
    assert {label.noise_factor for label in mixed if label.noise != "misdeclared"} == {1.0}
    plain = draw_labels(hand, counts, np.random.default_rng(1))
    assert "noise" not in plain[0].model_dump_json()
