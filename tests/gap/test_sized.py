"""Names beside others whose size nobody could tell from none are left out at the end."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap import sized
from candata.gap.attribute import Attribution
from candata.gap.refine import joint
from candata.gap.stage import look
from tests.gap.conftest import members


@pytest.fixture(scope="module")
def found(arm, two_causes):
    """A set of two true causes and one that is worth nothing."""
    problem, base = two_causes
    fit = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03, servo_gain=0.005), base)
    first = look(problem, problem.nominal, ())
    return problem, Attribution(first, fit, (fit,), problem.score, True, (fit,))


def reaching(**reach):
    """Intervals that reach so many times as far as the neutral value, by member."""

    def ends(problem, fit):
        own = np.concatenate([u for _, u in fit.members])
        away = own - np.concatenate([c.neutral for c, _ in fit.members])
        far = np.abs(away) * [reach.get(c.name, 0.1) for c, _ in fit.members]
        return own - far, own + far

    return ends


@pytest.mark.parametrize(("times", "left"), [(4.0, False), (1.5, True)])
def test_what_may_as_well_be_neutral_is_left_out_and_the_others_fitted_again(found, monkeypatch, times, left):
    problem, before = found
    monkeypatch.setattr(sized, "intervals", reaching(servo_gain=times))
    after = sized.with_sizes(problem, before)
    if left:
        assert after is before
        return
    assert after.chosen.labels == ("joint_dry_friction", "actuation_delay")
    assert after.chosen.members[0][1] == pytest.approx(0.3, rel=0.05)
    assert (after.tied, after.rivals) == ((after.chosen,), ())
    assert after.score is not before.score, "in units of the floor of its own world"
    assert not after.remains


@pytest.mark.parametrize("told", [True, False])
def test_what_does_as_well_and_is_told_from_none_takes_the_place_of_what_is_not(arm, found, monkeypatch, told):
    problem, before = found
    base = problem.score.loss(problem.nominal)
    rival = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03, servo_damping=0.01), base)
    monkeypatch.setattr(sized, "intervals", reaching(servo_gain=4.0, servo_damping=0.1 if told else 4.0))
    after = sized.with_sizes(problem, replace(before, rivals=(before.chosen, rival)))
    others = ("joint_dry_friction", "actuation_delay")
    assert after.chosen.labels == ((*others, "servo_damping") if told else others)
    assert after.rivals == ()


def test_what_is_worth_much_stays_however_wide_its_interval(found, monkeypatch):
    problem, before = found
    monkeypatch.setattr(sized, "intervals", reaching(joint_dry_friction=9.0, actuation_delay=9.0))
    assert sized.with_sizes(problem, before) is before


def test_what_was_measured_stays(found, monkeypatch):
    problem, before = found
    (gain,) = [m for m in before.chosen.members if m[0].name == "servo_gain"]
    monkeypatch.setattr(sized, "intervals", reaching(servo_gain=9.0))
    assert sized.with_sizes(replace(problem, measured=(gain,)), before) is before


@pytest.mark.parametrize(("both", "left_out"), [(1.1, 2), (1.5, 1)])
def test_names_that_make_up_for_one_another_are_not_all_left_out(arm, monkeypatch, both, left_out):
    """Each is worth a fiftieth beside the other, and together a quarter of the gap; or less than a fifth."""
    losses = {frozenset(): 1.0, frozenset("a"): 1.04, frozenset("b"): 1.05, frozenset("ab"): both}

    def residuals(sets):
        return [np.full(1, losses.get(frozenset("abc") - frozenset(c.name for c, _ in some), 3.0)) for some in sets]

    score = SimpleNamespace(loss=lambda z: z)
    problem = SimpleNamespace(
        score=score,
        nominal=np.full(1, 3.0),
        measured=(),
        residuals=residuals,
        setting=lambda some: some,
        without_each=lambda some: residuals([[m for m in some if m is not left] for left in some]),
    )
    own = tuple(
        (SimpleNamespace(name=name, label=name, choices=(), neutral=np.zeros(1), size=1), np.ones(1)) for name in "abc"
    )
    fit = SimpleNamespace(
        members=own, plane=SimpleNamespace(z=np.full(1, 1.0)), split=lambda u: [(c, u[:1]) for c, _ in own]
    )
    monkeypatch.setattr(sized, "intervals", lambda problem, fit: (np.full(1, -9.0), np.full(1, 9.0)))
    untold = sized._untold(problem, fit, (1 - sized.LITTLE) * sized._explained(problem, fit))
    assert [c.name for c, _ in untold] == ["a", "b"][:left_out]


def test_one_cause_many_tied_ones_and_none_stay(found, two_causes, arm):
    problem, before = found
    alone = joint(problem, members(arm, joint_dry_friction=0.3), two_causes[1])
    many = replace(before.chosen, members=before.chosen.members * 2)
    for one in (
        replace(before, chosen=alone, tied=(alone,)),
        replace(before, chosen=many, tied=(many,)),
        replace(before, tied=(before.chosen, alone)),
        replace(before, chosen=None, tied=()),
    ):
        assert sized.with_sizes(problem, one) is one


@pytest.mark.parametrize("known", [True, False])
def test_what_was_measured_does_not_count_among_many(found, arm, monkeypatch, known):
    problem, before = found
    (extra,) = members(arm, armature=1e-4)
    four = replace(before.chosen, members=(*before.chosen.members, extra))
    asked = []
    monkeypatch.setattr(sized, "_sized", lambda problem, found, best, least: asked.append(best))
    sized.with_sizes(replace(problem, measured=(extra,) if known else ()), replace(before, chosen=four, tied=(four,)))
    assert asked == ([four] if known else [])
