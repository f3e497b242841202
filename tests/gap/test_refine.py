"""Refinement: rollouts where they make a fit sharper, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap import refine
from candata.gap.added import here_of
from candata.gap.candidates import candidate
from candata.gap.diagnosis import _problem
from candata.gap.floor import perturbed
from candata.gap.folds import cross_fit
from candata.gap.recordings import recordings
from candata.gap.replay import Replayer
from candata.gap.response import Plane
from candata.gap.screen import respond
from candata.gap.search import Fit, Problem, fit_one


@pytest.fixture(scope="module")
def problem(arm, arm_episodes, planted, tmp_path_factory):
    """The problem that an arm with dry joints poses."""
    episodes = arm_episodes(planted("joint_dry_friction", frictionloss_Nm=0.3), count=12)
    return _problem(
        Replayer(arm),
        recordings(arm, episodes),
        np.random.default_rng(0),
        tmp_path_factory.mktemp("kept"),
        lambda stage: None,
        share=True,
    )


@pytest.fixture
def rollouts(monkeypatch):
    """The effects of every set that is simulated on the recording, in order."""
    asked, real = [], Problem.residuals

    def counted(problem, variants):
        asked.extend(tuple(s.name for s in some) for some in variants)
        return real(problem, variants)

    monkeypatch.setattr(Problem, "residuals", counted)
    return asked


def alone(problem, *names):
    base = problem.score.loss(problem.nominal)
    found = [candidate(name, problem.replayer.scene) for name in names]
    return [fit_one(problem, c, r, base) for c, r in respond(problem, problem.nominal, found)[0]], base


def test_beside_nothing_an_effect_that_promises_little_is_not_simulated(problem, rollouts):
    fits, base = alone(problem, "joint_dry_friction", "armature")
    fits.sort(key=lambda f: -f.gain)
    assert fits[1].gain < refine.PROMISE * fits[0].gain
    refine.refined(problem, fits, base, ())
    assert {*rollouts} == {("joint_dry_friction",)}


def test_a_scalar_is_simulated_around_its_best_and_there(problem, rollouts):
    (rough,), base = alone(problem, "joint_dry_friction")
    found = refine.polished(problem, rough, base)
    assert len(rollouts) == 3
    assert found.members[0][1][0] == pytest.approx(0.3, rel=0.03)
    sure = found.curve.at[found.curve.sure]
    assert np.abs(sure - found.members[0][1][0]).min() < 0.02 * 0.3


@pytest.mark.parametrize(("helpful", "simulated"), [(0, (0, 2)), (1, (0, 1, 2)), (3, (0, 1, 2))])
def test_where_a_width_helps_no_more_only_the_last_is_simulated(problem, monkeypatch, helpful, simulated):
    widths = []

    def differences(problem, members, world, z, width):
        widths.append(width)
        return np.zeros((1, *z.shape), z.dtype)

    def descended(problem, fit, plane, slope):
        return replace(plane, z=plane.z.copy()) if 0 < len(widths) <= helpful else plane

    monkeypatch.setattr(refine, "_differences", differences)
    monkeypatch.setattr(refine, "_descended", descended)
    c = candidate("joint_damping", problem.replayer.scene)
    refine.joint(problem, ((c, np.full(1, 0.3)),), problem.score.loss(problem.nominal))
    assert widths == [refine.WIDTHS[i] for i in simulated]


@pytest.mark.parametrize(("names", "simulated"), [(3, True), (4, False)])
def test_of_a_few_effects_the_slopes_of_all_numbers_are_simulated(problem, monkeypatch, names, simulated):
    """However many they are: sixteen joint offsets and a torque limit are two names. Of many names, few numbers."""
    monkeypatch.setattr(refine, "MOST_SLOPES", 1)
    asked, real = [], refine._differences
    monkeypatch.setattr(refine, "_differences", lambda *a: asked.append(a) or real(*a))
    base = problem.score.loss(problem.nominal)
    some = ("joint_dry_friction", "joint_damping", "armature", "actuation_delay")[:names]
    scene = problem.replayer.scene
    refine.joint(problem, tuple((c, c.neutral + 1e-3) for c in (candidate(n, scene) for n in some)), base)
    assert bool(asked) == simulated


def test_no_slopes_are_simulated_of_a_set_that_leaves_next_to_nothing(problem, monkeypatch):
    monkeypatch.setattr(refine, "_differences", lambda *a: pytest.fail("slopes were simulated"))
    c, base = candidate("joint_dry_friction", problem.replayer.scene), problem.score.loss(problem.nominal)
    found = refine.joint(problem, ((c, np.full(1, 0.3)),), base)
    left = float(problem.score.loss(found.plane.z).mean()) - 1
    assert left < refine.SHARP * float(base.mean())
    with pytest.raises(pytest.fail.Exception, match="slopes were simulated"):
        refine.joint(replace(problem, score=replace(problem.score, floor=problem.score.floor / 2)), found.members, base)


def test_replays_from_several_starts_are_those_from_each(problem):
    begins = [perturbed(problem.replayer, problem.begin, problem.noise, np.random.default_rng(i)) for i in range(2)]
    c = candidate("joint_dry_friction", problem.replayer.scene)
    worlds = [(), problem.setting([(c, np.full(1, 0.2))])]
    together = problem.losses_from(begins, worlds)
    assert together.shape == (2, 2, len(problem.recs))
    for begin, losses in zip(begins, together, strict=True):
        own = replace(problem, begin=begin).residuals(worlds)
        assert losses == pytest.approx(np.array([problem.score.loss(z) for z in own]), abs=1e-12)
    assert not np.array_equal(*together[:, 0])


def test_where_a_scalar_was_simulated_it_is_read_and_not_simulated_again(problem, rollouts):
    (rough,), base = alone(problem, "joint_dry_friction")
    ((c, _),) = rough.members
    found = refine.polished(problem, rough, base)
    there = found.curve.at[found.curve.sure][-1:]
    simulated = problem.residuals([problem.setting([(c, there)])])[0]
    rollouts.clear()
    assert np.allclose(here_of(problem, replace(found, members=((c, there),))), simulated, atol=1e-4)
    assert rollouts == []
    here_of(problem, replace(found, members=((c, there + 0.001),)))
    assert rollouts == [("joint_dry_friction",)]


def test_a_number_on_the_wrong_side_is_mirrored_where_that_leaves_less(arm, arm_episodes, planted, monkeypatch):
    recs = recordings(arm, arm_episodes(planted("joint_offset", offset_rad=[0.06, -0.05]), count=12))
    problem = _problem(Replayer(arm), recs, np.random.default_rng(0), None, lambda stage: None)
    base = problem.score.loss(problem.nominal)
    c = candidate("joint_offset", arm)

    def mirrored(*u):
        here = problem.residuals([problem.setting([(c, np.array(u))])])[0]
        plane = Plane(c.low, c.high, np.array(u), here, np.zeros((2, *here.shape), np.float32))
        evidence = cross_fit(plane, problem.score, problem.parts, base)
        ((_, found),) = refine._mirrored(problem, Fit(((c, np.array(u)),), plane, evidence), base)
        return tuple(found)

    assert mirrored(0.06, 0.05) == pytest.approx((0.06, -0.05))
    assert mirrored(0.06, -0.05) == pytest.approx((0.06, -0.05))
    monkeypatch.setattr(refine, "FEW_NUMBERS", 1)  # of many numbers this would cost too much
    assert mirrored(0.06, 0.05) == pytest.approx((0.06, 0.05))
