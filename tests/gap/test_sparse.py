"""The joint sparse fit: many small causes at once, and no cause where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap import sparse as module
from candata.gap.candidates import candidate
from candata.gap.recordings import recordings
from candata.gap.refine import WIDTHS, joint
from candata.gap.sparse import pruned, sparse
from candata.gap.stage import typical
from tests.gap.conftest import step_problem

#: Four things wrong at once, the damping most of all.
WRONG = {
    "joint_damping": {"damping_Nms_rad": 0.2},
    "joint_dry_friction": {"frictionloss_Nm": 0.08},
    "armature": {"armature_kgm2": 0.005},
    "actuation_delay": {"delay_s": 0.004},
}


@pytest.fixture(scope="module")
def found(arm, arm_episodes, planted):
    """The joint fit around the damping alone, and the loss of the nominal arm."""
    effects = tuple(s for name, x in WRONG.items() for s in planted(name, **x))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = step_problem(arm, recs)
    base, _ = typical(problem, problem.nominal, ())
    c = candidate("joint_damping", arm)
    start = joint(problem, ((c, np.full(1, 0.2)),), base)
    return sparse(problem, start, base), start, base, problem


def test_all_that_is_wrong_is_in_the_set_and_nothing_else(found):
    fit, *_ = found
    assert {c.name for c, _ in fit.members} == set(WRONG)


@pytest.mark.parametrize("spare", [True, False])
def test_what_is_worth_nothing_is_left_out_before_the_sharp_fit(found, monkeypatch, spare):
    """Slopes over one width tell; where all are worth something, the sharp fit goes on from the next width."""
    _, start, base, problem = found
    made = []

    def counted(problem, members, base, widths=WIDTHS):
        made.append(widths)
        return joint(problem, members, base, ())

    monkeypatch.setattr(module, "joint", counted)

    def worthy(problem, fit, base, sure=frozenset()):
        return fit.members[: 2 if spare else None], sure

    monkeypatch.setattr(module, "_worthy", worthy)
    module.sparse(problem, start, base)
    assert made == [WIDTHS[:1], *([()] if spare else []), WIDTHS[1:]]


def test_what_is_worth_much_is_not_asked_again_once_others_are_left_out(found, monkeypatch):
    fit, _, base, problem = found
    kept, sure = module._worthy(problem, fit, base)
    assert kept == fit.members
    assert "joint_damping" in sure, "most of the gap"
    asked = []

    def residuals(self, variants):
        asked.extend(variants)
        return [self.nominal for _ in variants]

    monkeypatch.setattr(type(problem), "residuals", residuals)
    again, _ = module._worthy(problem, fit, base, sure)
    assert {c.label for c, _ in again} >= sure
    assert len(asked) == len(fit.members) - len(sure)


def test_the_set_closes_what_one_cause_could_not(found):
    fit, start, base, _ = found
    assert fit.evidence.loss.mean() < 1.3 < start.evidence.loss.mean()
    assert fit.gain > start.gain
    assert fit.evidence.loss == pytest.approx(base - fit.evidence.gain)


def test_values_are_near_the_true_ones(found):
    fit, *_ = found
    values = {c.name: float(c.values(u)[0]) for c, u in fit.members if c.size == 1}
    # Four overlapping causes from 1 mrad of noise: a tenth of each.
    assert values["joint_damping"] == pytest.approx(0.2, rel=0.1)
    assert values["actuation_delay"] == pytest.approx(0.004, rel=0.1)


def test_slopes_promise_what_a_simulation_without_a_member_shows(found):
    fit, _, _, problem = found
    here = problem.score.loss(fit.plane.z).mean()
    promised = [problem.score.loss(fit.plane_without([m]).z).mean() - here for m in fit.members]
    shown = [problem.score.loss(z).mean() - here for z in problem.without_each(fit.members)]
    assert promised == pytest.approx(shown, rel=0.5)
    assert np.argmax(promised) == np.argmax(shown)


def test_a_member_that_slopes_promise_nothing_of_is_dropped_without_a_simulation_of_the_others(found, arm, monkeypatch):
    fit, _, base, problem = found
    c = candidate("backlash", arm)
    more = joint(problem, (*fit.members, (c, c.neutral + 1e-5)), base)
    worlds, real = [], type(problem).residuals
    monkeypatch.setattr(type(problem), "residuals", lambda p, v: worlds.extend(v) or real(p, v))
    assert {c.name for c, _ in pruned(problem, more, base).members} == set(WRONG)
    assert not any("backlash" in {s.name for s in world} for world in worlds)


def test_a_fit_that_cannot_reach_what_is_asked_ends_before_its_members_are_tried(found, monkeypatch):
    _, start, base, problem = found
    monkeypatch.setattr(module, "thinned", lambda *_: pytest.fail("its members are tried"))
    assert sparse(problem, start, base, least=2 * float(base.mean())) is None


def test_a_choice_that_was_accepted_stays(found, arm):
    """It has no slope, by which the penalty would take it for nothing."""
    _, start, base, problem = found
    ((damping, u),) = start.members
    choice = candidate("integrator", arm)
    both = joint(problem, ((choice, np.ones(1)), (damping, u)), base)
    after = sparse(problem, both, base)
    assert {c.name for c, _ in after.members} == {"integrator", *WRONG}
    assert after.members[0][1] == [1.0]


@pytest.mark.parametrize("jumps", [True, False])
def test_what_changes_episodes_at_its_neutral_value_is_not_fitted_together(found, monkeypatch, jumps):
    """As one value does that stands in for several."""
    _, start, _, problem = found
    real = type(problem).residuals

    def residuals(self, worlds):
        off = [jumps and any(s.name == "backlash" for s in world) for world in worlds]
        return [self.nominal if far else z for far, z in zip(off, real(self, worlds), strict=True)]

    monkeypatch.setattr(type(problem), "residuals", residuals)
    labels = [c.label for c, _ in module._everything(problem, start)]
    assert labels[0] == "joint_damping"
    assert "servo_gain" in labels
    assert ("backlash" in labels) is not jumps


@pytest.mark.parametrize(("better", "sharp"), [(9.0, False), (-9.0, True)])
def test_where_no_other_name_stays_the_same_ones_are_fitted_sharply_only_if_they_explain_more(
    found, monkeypatch, better, sharp
):
    _, start, base, problem = found
    start = replace(start, evidence=replace(start.evidence, gain=start.evidence.gain + better))
    monkeypatch.setattr(module, "_worthy", lambda problem, fit, base, sure=None: (fit.members[:1], frozenset()))
    made = []

    def counted(problem, members, base, widths=WIDTHS):
        made.append(widths)
        return joint(problem, members, base, ())

    monkeypatch.setattr(module, "joint", counted)
    after = sparse(problem, start, base)
    assert (after is not None, made[2:]) == ((True, [WIDTHS[1:]]) if sharp else (False, []))
