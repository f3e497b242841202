"""Shares of wanted outcomes: how they are read, and which turn wants which."""

from __future__ import annotations

from collections import Counter

import pytest

from candata.errors import UnknownNameError, UsageError
from candata.simulate.jobs import GenerationRecipe
from candata.simulate.wanted import parsed_outcomes, wanted_outcome


@pytest.mark.parametrize(
    ("text", "shares"),
    [
        ("success:0.5,fail:0.5", {"success": 0.5, "fail": 0.5}),
        ("slip", {"slip": 1.0}),
        ("drop, miss", {"drop": 0.5, "miss": 0.5}),
        ("success:0.7,drop:0.2,topple:0.1", {"success": 0.7, "drop": 0.2, "topple": 0.1}),
    ],
)
def test_shares_are_read(text, shares):
    assert parsed_outcomes(text) == shares


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("success:0.5,fail:0.4", "the shares of --outcomes do not sum to 1"),
        ("success:0.5,success:0.5", "outcomes of different names"),
        ("success:half,fail:0.5", "a share above 0 for each outcome"),
        ("success:0.5,fail", "a share above 0 for each outcome"),
        ("success:1.5,fail:-0.5", "a share above 0 for each outcome"),
        ("success:nan,fail:0.5", "a share above 0 for each outcome"),
        ("", "outcomes of different names"),
    ],
)
def test_what_is_no_mix_is_refused(text, words):
    with pytest.raises(UsageError, match=words):
        parsed_outcomes(text)


def test_an_unknown_outcome_is_proposed():
    with pytest.raises(UnknownNameError, match="did you mean 'success'"):
        parsed_outcomes("sucess:1")


@pytest.mark.parametrize("shares", [{"success": 0.5, "fail": 0.5}, {"success": 0.7, "drop": 0.2, "topple": 0.1}])
def test_shares_are_met_after_any_number_of_turns(shares):
    turns = [wanted_outcome(shares, turn) for turn in range(1500)]
    for count in range(1, 1500, 7):
        seen = Counter(turns[:count])
        assert all(abs(seen[name] - share * count) <= 1 for name, share in shares.items())


def test_each_policy_and_object_gets_the_mix():
    recipe = GenerationRecipe(
        scene="cube_toss",
        seed=1,
        policies=("a", "b"),
        objects=("x", "y"),
        duration_s=1.0,
        noise=False,
        outcomes={"success": 0.5, "fail": 0.5},
    )
    for slot in range(4):
        wanted = Counter(recipe.wanted(index) for index in range(40) if index % 4 == slot)
        assert wanted == {"success": 5, "fail": 5}
