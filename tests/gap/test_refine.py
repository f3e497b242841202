"""Refinement: rollouts where they make a fit sharper, and no others."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import Candidate, candidate
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import cross_fit
from candata.gap.fit.problem import Problem, fit_one
from candata.gap.fit.response import Plane
from candata.gap.measure.floor import perturbed
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening import refinement, set_slopes
from candata.gap.screening.signature_screen import respond


@pytest.fixture(scope="module")
def problem(arm, arm_episodes, planted, tmp_path_factory):
    """The problem that an arm with dry joints poses."""
    episodes = arm_episodes(planted("joint_dry_friction", frictionloss_Nm=0.3), count=12)
    return _problem(
        Replayer(arm),
        recordings(arm, episodes),
        Streams(0),
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
    assert fits[1].gain < refinement.PROMISE * fits[0].gain
    refinement.refined(problem, fits, base)
    assert {*rollouts} == {("joint_dry_friction",)}


def test_a_scalar_is_simulated_around_its_best_and_there(problem, rollouts):
    (rough,), base = alone(problem, "joint_dry_friction")
    found = refinement.polished(problem, rough, base)
    assert len(rollouts) == 3
    assert found.members[0][1][0] == pytest.approx(0.3, rel=0.03)
    sure = found.curve.at[found.curve.sure]
    assert np.abs(sure - found.members[0][1][0]).min() < 0.02 * 0.3


@pytest.mark.parametrize(
    ("helpful", "simulated"),
    [(0, (0, 2)), (1, (0, 1, 2)), (3, (0, 1, 2, 2, 2)), (99, (0, 1, 2, *[2] * refinement.AGAIN))],
)
def test_slopes_are_simulated_again_while_that_helps_and_once_more(problem, monkeypatch, helpful, simulated):
    widths = []

    def differences(problem, members, world, z, width, known):
        widths.append(width)
        return np.zeros((1, *z.shape), z.dtype)

    def descended(problem, fit, plane, slope):
        return replace(plane, z=0.95 * plane.z) if 0 < len(widths) <= helpful else plane

    monkeypatch.setattr(refinement, "SHARP", -1.0)
    monkeypatch.setattr(refinement, "differences", differences)
    monkeypatch.setattr(refinement, "_descended", descended)
    members = ((candidate("joint_damping", problem.replayer.scene), np.full(1, 0.3)),)
    base = problem.score.loss(problem.nominal)
    refinement.joint(problem, members, base)
    assert widths == [refinement.WIDTHS[i] for i in simulated]
    widths.clear()
    refinement.joint(problem, members, base, refinement.WIDTHS[:1])
    assert widths == [refinement.WIDTHS[0]], "again over the last width alone"


@pytest.mark.parametrize(("names", "simulated"), [(3, True), (4, False)])
def test_of_a_few_effects_the_slopes_of_all_numbers_are_simulated(problem, monkeypatch, names, simulated):
    """However many they are: sixteen joint offsets and a torque limit are two names. Of many names, few numbers."""
    monkeypatch.setattr(refinement, "MOST_SLOPES", 1)
    asked, real = [], refinement.differences
    monkeypatch.setattr(refinement, "differences", lambda *a: asked.append(a) or real(*a))
    base = problem.score.loss(problem.nominal)
    some = ("joint_dry_friction", "joint_damping", "armature", "actuation_delay")[:names]
    scene = problem.replayer.scene
    refinement.joint(problem, tuple((c, c.neutral + 1e-3) for c in (candidate(n, scene) for n in some)), base)
    assert bool(asked) == simulated


def test_no_slopes_are_simulated_of_a_set_that_leaves_next_to_nothing(problem, monkeypatch):
    monkeypatch.setattr(refinement, "differences", lambda *a: pytest.fail("slopes were simulated"))
    problem = replace(problem, score=replace(problem.score, floor=1.1 * problem.score.floor))
    c, base = candidate("joint_dry_friction", problem.replayer.scene), problem.score.loss(problem.nominal)
    found = refinement.joint(problem, ((c, np.full(1, 0.3)),), base)
    above = float(problem.score.loss(found.plane.z).mean()) - 1
    assert above < refinement.SHARP * float(base.mean())
    with pytest.raises(pytest.fail.Exception, match="slopes were simulated"):
        refinement.joint(
            replace(problem, score=replace(problem.score, floor=problem.score.floor / 2)), found.members, base
        )


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
    found = refinement.polished(problem, rough, base)
    there = found.curve.at[found.curve.sure][-1:]
    simulated = problem.residuals([problem.setting([(c, there)])])[0]
    rollouts.clear()
    assert np.allclose(problem.where(replace(found, members=((c, there),))), simulated, atol=1e-4)
    assert rollouts == []
    problem.where(replace(found, members=((c, there + 0.001),)))
    assert rollouts == [("joint_dry_friction",)]


@pytest.fixture(scope="module")
def offset(arm, arm_episodes, planted):
    """The problem that two joints read 60 and -50 mrad off pose, the effect, and where it is true."""
    recs = recordings(arm, arm_episodes(planted("joint_offset", offset_rad=[0.06, -0.05]), count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
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
        ((_, found),) = refinement._mirrored(problem, Fit(((c, np.array(u)),), plane, evidence), base)
        return tuple(found)

    assert mirrored(0.06, 0.05) == pytest.approx((0.06, -0.05))
    assert mirrored(0.06, -0.05) == pytest.approx((0.06, -0.05))
    monkeypatch.setattr(refinement, "FEW_NUMBERS", 1)  # of many numbers this would cost too much
    assert mirrored(0.06, 0.05) == pytest.approx((0.06, 0.05))


def test_a_step_that_noisy_slopes_make_too_short_goes_on_while_it_gains(offset):
    problem, c, true = offset
    rng, begin = np.random.default_rng(0), np.array([0.03, -0.02])
    here = placed(problem, c, begin)
    slope = refinement.differences(problem, ((c, begin),), lambda u: ((c, u),), here.z, 0.25)
    noise = rng.normal(0, 2 * slope.std(axis=(1, 2), keepdims=True), slope.shape).astype(np.float32)
    plane = replace(here, slope=slope + noise)
    target = plane.best(np.arange(len(plane.z)))
    near, far = (refinement.stepped(problem, plane, target, lambda u: ((c, u),), goes) for goes in (False, True))
    assert left(problem, far) < left(problem, near) < left(problem, plane)
    assert np.linalg.norm(far.at - true) < np.linalg.norm(near.at - true)


def test_a_step_stays_inside_the_bounds_however_far_it_gains(offset):
    problem, c, _ = offset
    bounds = {"low": np.array([0.01, -0.04]), "high": np.array([0.05, -0.02])}
    plane = replace(placed(problem, c, np.array([0.02, -0.03])), **bounds)  # flat: any gain is more than it promises
    found = refinement.stepped(problem, plane, np.array([0.03, -0.035]), lambda u: ((c, u),), True)
    assert found.at == pytest.approx([0.04, -0.04])


@pytest.fixture
def two(problem):
    """Two effects a little off their true values: three numbers, their world, and where they are."""
    scene = problem.replayer.scene
    dry, gain = (candidate(name, scene) for name in ("joint_dry_friction", "servo_gain"))
    return ((dry, np.full(1, 0.25)), (gain, gain.neutral))


def asked(problem, members, world, known):
    """The coordinates that slopes are read at, and the slopes."""
    seen = []

    def here(u):
        seen.append(np.asarray(u))
        return world(u)

    z = problem.residuals([problem.setting(members)])[0]
    return seen, refinement.differences(problem, members, here, z, 0.25, known)


def test_slopes_along_turned_directions_are_those_along_numbers(problem, two):
    world = partial(refinement.divided, two)
    _, plain = asked(problem, two, world, None)
    seen, turned = asked(problem, two, world, plain)
    away = np.array(seen) - np.concatenate([u for _, u in two])
    assert (np.count_nonzero(np.abs(away) > 1e-6, axis=1) > 1).any(), "not along the numbers themselves"
    assert np.abs(turned - plain).mean() < 0.2 * np.abs(plain).mean()


def test_a_choice_has_no_slope_and_leaves_the_others_theirs(problem, two):
    scene = problem.replayer.scene
    choices = tuple((c, c.low) for c in (candidate(name, scene) for name in ("integrator", "time_step")))
    fit = refinement.joint(problem, choices, problem.score.loss(problem.nominal))
    assert not fit.plane.slope.any()
    assert [u[0] for _, u in fit.members] == [u[0] for _, u in choices]
    both = (choices[0], *two)
    _, plain = asked(problem, both, partial(refinement.divided, both), None)
    _, turned = asked(problem, both, partial(refinement.divided, both), plain)
    assert not turned[0].any()
    assert turned[1:].any(axis=(1, 2)).all()


class Valley:
    """Two numbers that nearly make up for one another, read with chaos that is anew in every world."""

    def __init__(self, chaos: float):
        rng = np.random.default_rng(3)
        once, other = rng.normal(0, 1, (2, 6, 40))
        self.slope = np.stack([once + 0.05 * other, once]).astype(np.float32)
        self.chaos, self.rng = chaos, rng
        self.replayer = SimpleNamespace(scene=None)

    def setting(self, members):
        return np.concatenate([u for _, u in members])

    def residuals(self, worlds):
        return [
            (np.tensordot(u, self.slope, 1) + self.chaos * self.rng.normal(0, 1, self.slope.shape[1:])).astype(
                np.float32
            )
            for u in worlds
        ]


@pytest.fixture
def pair(monkeypatch):
    """An effect of two numbers between -9 and 9, of which one is plausible."""
    monkeypatch.setattr(set_slopes, "typical_size", lambda c, scene: np.ones(2))
    c = Candidate(
        "joint_offset",
        None,
        np.zeros(2),
        np.full(2, -9.0),
        np.full(2, 9.0),
        np.zeros(2, bool),
        False,
        np.ones(2, bool),
        np.zeros(2),
    )
    return c


def test_what_two_numbers_do_together_is_told_where_each_does_much(pair):
    members, valley = ((pair, np.zeros(2)),), Valley(0.1)
    world, z = partial(refinement.divided, members), np.zeros((6, 40), np.float32)
    wrong, known = [], None
    for _ in range(3):
        known = refinement.differences(valley, members, world, z, 0.25, known)
        together = known[0] - known[1] - (valley.slope[0] - valley.slope[1])
        wrong.append(float(np.sqrt((together**2).mean())))
    assert wrong[2] < 0.5 * wrong[0]


@pytest.mark.parametrize("at", [(-9.0, 0.0), (9.0, 9.0), (8.9, -8.9), (0.0, 0.1)])
def test_slopes_are_read_inside_the_bounds(pair, at):
    members, valley = ((pair, np.array(at)),), Valley(0.0)
    seen, slope = asked(valley, members, partial(refinement.divided, members), valley.slope)
    assert all((np.abs(u) <= 9.0).all() for u in seen)
    assert slope == pytest.approx(valley.slope, abs=1e-4)
