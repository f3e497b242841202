"""Which ends of a number's interval are known: by losses simulated outwards to its bounds."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.fit.candidates import candidate
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import CrossFit
from candata.gap.fit.response import Curve, Plane
from candata.gap.validation.profile import COSTS, known_numbers

EPISODES = 16
#: Spread over episodes of the coordinate with the least loss, of one that is bound to 0.3.
SPREAD = 0.004


class Episodes(tuple):
    """Numbers of episodes, all of one task."""

    @property
    def tasks(self):
        return ("press",) * len(self)


@pytest.fixture(autouse=True)
def _taken(monkeypatch):
    """Let all episodes be simulated."""
    for module in ("profile", "intervals"):
        monkeypatch.setattr(f"candata.gap.validation.{module}.taken", lambda problem, some: problem)
        monkeypatch.setattr(f"candata.gap.validation.{module}.every_other", lambda tasks: np.arange(len(tasks)))


def posed(arm, rise, own, seed=0, weight=1e4):
    """A problem of gears' play whose loss is 1 + `weight * rise(u + each episode's own, E)`, and its fit at `own`.

    Its worlds are counted in `problem.tried`.
    """
    c = candidate("backlash", arm, arm.file.joints[0])
    rng = np.random.default_rng(seed)
    off, tried = SPREAD * rng.standard_normal(EPISODES), []
    off -= off.mean()

    def loss(u):
        return 1 + weight * rise(float(u[0]), off)

    def residuals(worlds):
        tried.extend(float(u[0]) for u in worlds)
        return [np.repeat(loss(u)[:, None], 30, axis=1) for u in worlds]

    at = np.unique([0.0, own / 2, own, (own + c.high[0]) / 2, c.high[0]])
    z = np.stack([np.repeat(loss([u])[:, None], 30, axis=1) for u in at]).astype(np.float32)
    problem = SimpleNamespace(
        recs=Episodes(range(EPISODES)),
        replayer=SimpleNamespace(scene=arm),
        stream=lambda *asked: np.random.default_rng(seed),
        residuals=residuals,
        tried=tried,
        score=SimpleNamespace(loss=lambda z: z.mean(-1), nats=lambda: np.full(EPISODES, 10.0)),
        setting=lambda members: members[0][1],
    )
    members = ((c, np.array([own])),)
    return problem, Fit(members, Curve(c, at, z, np.ones(len(at), bool)), CrossFit(*np.zeros((3, 1, 1))))


def valley(least):
    """A parabola around `least`."""
    return lambda u, off: (u - least - off) ** 2


def step(edge, top=None):
    """A slope that ends at `edge`, and begins again at `top` where one is given."""

    def rise(u, off):
        below, above = np.maximum(edge + off - u, 0), np.maximum(u - top - off, 0) if top else 0.0
        return below**2 + above**2

    return rise


def resampled(monkeypatch):
    """Let resampling say what it would of a parabola: 1.645 standard errors to both sides."""
    monkeypatch.setattr("candata.gap.validation.profile.intervals", known_by_resampling)


def known_by_resampling(problem, fit):
    """The ends of a parabola's interval."""
    ((_, own),), error = fit.members, 1.645 * SPREAD / np.sqrt(EPISODES)
    return own - error, own + error


def test_of_an_effect_with_an_end_only_that_end_is_known(arm):
    problem, fit = posed(arm, step(0.06), own=0.2)
    found = known_numbers(problem, fit)
    assert (found.no_low.tolist(), found.no_high.tolist()) == ([False], [True])
    assert 0.05 < found.low[0] < found.value[0] < 0.07
    assert found.value[0] < 0.2


def test_a_flat_stretch_that_ends_before_the_bound_is_an_interval_of_two_ends(arm):
    problem, fit = posed(arm, step(0.06, top=0.2), own=0.1)
    found = known_numbers(problem, fit)
    assert not found.no_low[0]
    assert not found.no_high[0]
    assert (found.low[0], found.high[0]) == pytest.approx((0.06, 0.2), abs=2 * SPREAD)
    assert found.value[0] == 0.1


def test_where_the_loss_rises_to_both_sides_few_worlds_are_simulated_and_the_interval_stands(arm, monkeypatch):
    problem, fit = posed(arm, valley(0.1), own=0.1)
    resampled(monkeypatch)
    problem.tried.clear()
    found = known_numbers(problem, fit)
    assert len(problem.tried) <= 5
    assert not (found.no_low | found.no_high).any()
    assert (*found.low, *found.high) == pytest.approx(np.ravel(known_by_resampling(problem, fit)))


def test_it_holds_the_truth_about_nine_times_in_ten(arm, monkeypatch):
    resampled(monkeypatch)
    hits = []
    for seed in range(150):
        rng = np.random.default_rng([seed, 1])
        own = float(0.1 + SPREAD / np.sqrt(EPISODES) * rng.standard_normal())
        problem, fit = posed(arm, valley(own), own, seed)
        found = known_numbers(problem, fit)
        hits.append(found.low[0] <= 0.1 <= found.high[0])
    # 150 draws scatter by 0.025.
    assert 0.84 <= np.mean(hits) <= 0.97


def test_a_rise_that_costs_less_than_a_nat_is_none_however_alike_in_all_episodes(arm):
    """Stuck joints creep: what more friction changes is the same in every episode and far below any noise."""
    tiny = 0.5 * COSTS / (10.0 * EPISODES)

    def rise(u, off):
        return np.maximum(0.06 + off - u, 0) ** 2 + tiny / 1e4 * np.clip((u - 0.1) / 0.2, 0, 1)

    assert known_numbers(*posed(arm, rise, own=0.1)).no_high[0]

    def plain(u, off):
        return np.maximum(0.06 + off - u, 0) ** 2 + 8 * tiny / 1e4 * np.clip((u - 0.1) / 0.01, 0, 1)

    assert not known_numbers(*posed(arm, plain, own=0.1)).no_high[0]


def test_a_number_that_stopped_at_its_bound_is_known_from_the_other_side(arm):
    c = candidate("backlash", arm, arm.file.joints[0])
    found = known_numbers(*posed(arm, valley(c.high[0] + 0.05), own=float(c.high[0])))
    assert (found.no_low.tolist(), found.no_high.tolist()) == ([False], [True])
    assert found.low[0] > 0.28


def test_where_the_loss_has_not_even_risen_at_the_effects_absence_the_interval_stays(arm, monkeypatch):
    problem, fit = posed(arm, lambda u, off: 0 * off, own=0.1)
    monkeypatch.setattr(
        "candata.gap.validation.profile.intervals", lambda problem, fit: (np.array([0.08]), np.array([0.12]))
    )
    found = known_numbers(problem, fit)
    assert (found.low, found.value, found.high) == (0.08, 0.1, 0.12)
    assert not (found.no_low | found.no_high).any()


def test_of_a_set_each_only_number_is_tried_with_the_others_held_and_vectors_and_choices_are_not(arm, monkeypatch):
    some = [candidate(name, arm) for name in ("backlash", "joint_offset", "integrator", "joint_damping")]
    own = [np.full(1, 0.1), np.zeros(2), some[2].low, np.full(1, 0.2)]
    members, size = tuple(zip(some, own, strict=True)), sum(c.size for c in some)
    at, tried = np.concatenate(own), []

    def residuals(worlds):
        tried.extend(worlds)
        each = np.linspace(0.9, 1.1, EPISODES)
        losses = [1 + each * (1e4 * max(0.06 - u[0], 0) ** 2 + 1e4 * (u[4] - 0.2) ** 2) for u in worlds]
        return [np.repeat(loss[:, None], 30, axis=1) for loss in losses]

    problem = SimpleNamespace(
        recs=Episodes(range(EPISODES)),
        residuals=residuals,
        score=SimpleNamespace(loss=lambda z: z.mean(-1), nats=lambda: np.full(EPISODES, 10.0)),
        setting=lambda members: np.concatenate([u for _, u in members]),
    )
    flat = np.zeros((EPISODES, 30), np.float32)
    fit = Fit(members, Plane(at, at, at, flat, np.zeros((size, *flat.shape))), CrossFit(*np.zeros((3, 1, 1))))
    monkeypatch.setattr("candata.gap.validation.profile.intervals", lambda problem, fit: (at - 0.01, at + 0.01))
    found = known_numbers(problem, fit)
    assert found.no_high.tolist() == [True, False, False, False, False]
    assert not found.no_low.any()
    assert 0.04 < found.value[0] < 0.06
    assert found.value[1:].tolist() == at[1:].tolist()
    changed = np.array(tried) != at
    assert (changed.sum(1) <= 1).all()
    assert not changed[:, 1:4].any()
