"""Refinement: rollouts where they make a fit sharper, and no others."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

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
from candata.gap.score import weights
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
    problem = replace(problem, score=replace(problem.score, floor=1.1 * problem.score.floor))
    c, base = candidate("joint_dry_friction", problem.replayer.scene), problem.score.loss(problem.nominal)
    found = refine.joint(problem, ((c, np.full(1, 0.3)),), base)
    above = float(problem.score.loss(found.plane.z).mean()) - 1
    assert above < refine.SHARP * float(base.mean())
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


@pytest.fixture(scope="module")
def offset(arm, arm_episodes, planted):
    """The problem that two joints read 60 and -50 mrad off pose, the effect, and where it is true."""
    recs = recordings(arm, arm_episodes(planted("joint_offset", offset_rad=[0.06, -0.05]), count=12))
    problem = _problem(Replayer(arm), recs, np.random.default_rng(0), None, lambda stage: None)
    return problem, candidate("joint_offset", arm), np.array([0.06, -0.05])


def placed(problem, c, u, slope=None):
    """The plane of a candidate around coordinates, flat without a slope."""
    here = problem.residuals([problem.setting([(c, u)])])[0]
    return Plane(c.low, c.high, u, here, np.zeros((len(u), *here.shape), np.float32) if slope is None else slope)


def left(problem, plane):
    return float(problem.score.loss(plane.z).mean())


def test_a_number_on_the_wrong_side_is_mirrored_where_that_leaves_less(offset, monkeypatch):
    problem, c, _ = offset
    base = problem.score.loss(problem.nominal)

    def mirrored(*u):
        plane = placed(problem, c, np.array(u))
        evidence = cross_fit(plane, problem.score, problem.parts, base)
        ((_, found),) = refine._mirrored(problem, Fit(((c, np.array(u)),), plane, evidence), base)
        return tuple(found)

    assert mirrored(0.06, 0.05) == pytest.approx((0.06, -0.05))
    assert mirrored(0.06, -0.05) == pytest.approx((0.06, -0.05))
    monkeypatch.setattr(refine, "FEW_NUMBERS", 1)  # of many numbers this would cost too much
    assert mirrored(0.06, 0.05) == pytest.approx((0.06, 0.05))


def test_a_step_that_noisy_slopes_make_too_short_goes_on_while_it_gains(offset):
    problem, c, true = offset
    rng, begin = np.random.default_rng(0), np.array([0.03, -0.02])
    here = placed(problem, c, begin)
    slope = refine._differences(problem, ((c, begin),), lambda u: ((c, u),), here.z, 0.25)
    noise = rng.normal(0, 2 * slope.std(axis=(1, 2), keepdims=True), slope.shape).astype(np.float32)
    plane = replace(here, slope=slope + noise)
    target = plane.best(np.arange(len(plane.z)))
    near, far = (refine.stepped(problem, plane, target, lambda u: ((c, u),), goes) for goes in (False, True))
    assert left(problem, far) < left(problem, near) < left(problem, plane)
    assert np.linalg.norm(far.at - true) < np.linalg.norm(near.at - true)


def test_a_step_stays_inside_the_bounds_however_far_it_gains(offset):
    problem, c, _ = offset
    bounds = {"low": np.array([0.01, -0.04]), "high": np.array([0.05, -0.02])}
    plane = replace(placed(problem, c, np.array([0.02, -0.03])), **bounds)  # flat: any gain is more than it promises
    found = refine.stepped(problem, plane, np.array([0.03, -0.035]), lambda u: ((c, u),), True)
    assert found.at == pytest.approx([0.04, -0.04])


@pytest.fixture
def aside(problem):
    """The true set of two effects, its plane there, and the directions that show least and most, in its numbers."""
    scene = problem.replayer.scene
    dry, gain = (candidate(name, scene) for name in ("joint_dry_friction", "servo_gain"))
    members = ((dry, np.full(1, 0.3)), (gain, gain.neutral))
    world = partial(refine.divided, members)
    plane = refine.around(problem, members, world)
    plane = replace(plane, slope=refine._differences(problem, members, world, plane.z, refine.WIDTHS[-1]))
    size = np.concatenate([refine.typical_size(c, scene) for c, _ in members])
    flat = (plane.slope * size[:, None, None]).reshape(2, -1)
    weak, strong = np.linalg.eigh(((flat * weights(plane.z).ravel()) @ flat.T).astype(float))[1].T * size
    evidence = cross_fit(plane, problem.score, problem.parts, problem.score.loss(problem.nominal))
    return Fit(members, plane, evidence), weak, strong


def moved(problem, fit, u):
    """The plane of a fit moved to coordinates, its slopes kept."""
    return replace(fit.plane, at=u, z=problem.residuals([problem.setting(fit.split(u))])[0])


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("off", [0.0, 0.1])
def test_a_fit_that_stands_aside_moves_along_what_shows_least_and_down_the_rest(problem, aside, side, off):
    fit, weak, strong = aside
    plane = moved(problem, fit, fit.plane.at + side * refine.ASIDE * weak + off * strong)
    found = refine._aside(problem, fit, plane)
    assert left(problem, fit.plane) < 1.1
    assert left(problem, found) - 1 < 0.05 * (left(problem, plane) - 1)
    assert found.at == pytest.approx(fit.plane.at, abs=0.03)


def test_a_joint_fit_that_steps_leave_in_a_valley_gets_out_of_it(problem, aside, monkeypatch):
    fit, weak, _ = aside
    base, begin = problem.score.loss(problem.nominal), fit.plane.at + refine.ASIDE * weak
    monkeypatch.setattr(refine, "_descended", lambda problem, fit, plane, slope: plane)  # no step helps

    def fitted(widths=refine.WIDTHS):
        return np.concatenate([u for _, u in refine.joint(problem, fit.split(begin), base, widths).members])

    assert fitted() == pytest.approx(fit.plane.at, abs=0.03)
    for blunt in (refine.WIDTHS[:1], ()):  # where slopes are not simulated to the last, nor is this
        assert fitted(blunt) == pytest.approx(begin)
    monkeypatch.setattr(refine, "VALLEYS", 0)
    assert fitted() == pytest.approx(begin)


def test_of_one_number_nothing_lies_aside(problem):
    c, base = candidate("joint_dry_friction", problem.replayer.scene), problem.score.loss(problem.nominal)
    plane = placed(problem, c, np.full(1, 0.2))
    fit = Fit(((c, np.full(1, 0.2)),), plane, cross_fit(plane, problem.score, problem.parts, base))
    assert refine._aside(problem, fit, plane) is plane
