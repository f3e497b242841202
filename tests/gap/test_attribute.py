"""When a gain counts: against the nulls, against its own spread, and where the floor is too high."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.fit.acceptance import LARGEST, is_full
from candata.gap.fit.candidates import candidate
from candata.gap.fit.comparison import error_within, standard_error
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import CrossFit
from candata.gap.fit.stage import STEADY, Stage
from candata.gap.search import attribution

#: Losses of eight episodes within the nulls' range: a mean of 1.1 floors.
BASE = np.array([3.0, 0.2, 1.1, 1.2, 0.1, 1.9, 0.3, 1.0])
TASKS = ("lift",) * 8


def stage(gain: np.ndarray, reachable: float = 0.0) -> Stage:
    fit = Fit((), None, CrossFit(gain, BASE - gain, np.zeros((4, 1))))
    return Stage(BASE, np.zeros((4, 8)), (fit,), 0.07, (), (), (), reachable)


@pytest.mark.parametrize(
    ("gain", "plain"),
    [
        (np.full(8, 0.4), True),  # the same in every episode
        (np.array([0.3, 0.0, 0.3, 0.1, 0.0, 0.2, 0.2, 0.1]), True),  # twice what null sets reach, and nearly sure
        (np.array([0.6, -0.1, 0.5, 0.1, -0.2, 0.3, 0.0, 0.0]), False),  # twice as well, and as likely luck
        (np.array([0.6, 0.0, 0.5, 0.1, 0.0, 0.1, 0.0, 0.1]), False),  # the same, and the doing of a few
        (0.95 * BASE, True),  # uneven, as the episodes are, but nearly all of the loss
        (np.array([2.9, -0.1, 0.0, 0.1, 0.0, 0.2, -0.1, 0.1]), False),  # one episode's doing
        (np.full(8, 0.1), False),  # what null sets nearly reach
    ],
)
def test_a_gain_within_the_nulls_range_counts_when_it_is_plain(gain, plain):
    some = stage(gain)
    assert some.is_plain(some.fits[0], TASKS) is plain


@pytest.mark.parametrize(
    ("tasks", "plain"), [(("lift", "push", "roll", "rest") * 2, True), (("lift",) * 4 + ("push",) * 4, False)]
)
def test_a_gain_in_one_task_alone_counts_where_it_is_the_same_in_each_of_its_episodes(tasks, plain):
    """One motor's torque limit shows where that joint is driven hard; a few episodes of every task are luck."""
    some = stage(np.array([0.6, 0.0, 0.01, 0.0, 0.58, 0.0, 0.0, 0.01]))
    assert some.is_plain(some.fits[0], tasks) is plain


def test_a_gain_is_as_steady_as_it_is_though_not_all_of_it_counts():
    gain = np.array([0.5, 0.1, 0.3, 0.0, 0.1, 0.2, 0.3, 0.1])
    some = replace(stage(gain, reachable=float(BASE.mean()) - 0.12), threshold=0.01)
    assert some._counted(some.fits[0]) == pytest.approx(0.12)
    assert 0.12 < STEADY * standard_error(gain) < gain.mean()
    assert some.is_plain(some.fits[0], TASKS)


@pytest.mark.parametrize(
    ("sharp", "remains", "counts", "asked"), [(0.2, False, True, 1), (0.0, False, False, 1), (0.0, True, True, 0)]
)
def test_what_is_not_plain_within_the_nulls_range_counts_if_it_is_when_sharp(
    monkeypatch, sharp, remains, counts, asked
):
    some = stage(np.array([0.6, -0.1, 0.5, 0.1, -0.2, 0.3, 0.0, 0.0]))
    blunt = some.fits[0]
    calls = []

    def polished(problem, fit, base):
        calls.append(fit)
        return replace(fit, evidence=replace(fit.evidence, gain=fit.evidence.gain + sharp))

    monkeypatch.setattr(attribution, "polished", polished)
    assert some.passing() is blunt
    assert not some.is_plain(blunt, TASKS)
    first, best = attribution._counting(SimpleNamespace(recs=SimpleNamespace(tasks=TASKS)), some, remains)
    assert (best is not None, len(calls)) == (counts, asked)
    assert first.fits[0] is best or best is None


def test_a_loss_below_what_a_true_world_reaches_counts_for_nothing():
    gain = np.full(8, 0.15)
    assert stage(gain).passing() is not None
    assert stage(gain, reachable=float(BASE.mean()) - 0.01).passing() is None


def test_the_gain_of_one_episode_alone_is_luck():
    gain = np.array([2.0, *[0.02] * 7])
    assert gain.mean() > standard_error(gain)  # which alone would let it pass
    assert stage(gain).passing() is None
    assert stage(np.array([2.0, *[0.06] * 7])).passing() is not None


def test_how_sure_a_mean_is_within_tasks_is_what_draws_of_those_tasks_show(rng):
    tasks, level, spread = "aaabbbbbcc", np.repeat([0.0, 5.0, 9.0], (3, 5, 2)), np.repeat([0.1, 0.4, 0.2], (3, 5, 2))
    draws = level + spread * rng.standard_normal((4000, 10))
    found = np.sqrt(np.mean([error_within(values, tasks) ** 2 for values in draws]))
    assert found == pytest.approx(draws.mean(1).std(), rel=0.05)
    assert found < 0.2 * standard_error(draws[0])


@pytest.mark.parametrize("tasks", ["aaaaaaaa", "aaaaaaab", ""])
def test_of_one_task_or_a_single_episode_of_one_it_is_the_plain_error(tasks):
    assert error_within(BASE, tasks) == pytest.approx(standard_error(BASE))


def test_what_was_measured_takes_no_place_in_the_set(cube):
    names = ("object_inertia", "sliding_friction", "object_mass", "pose_scale")
    *free, known = [(c, c.neutral) for c in (candidate(name, cube) for name in names)]
    assert len(free) == LARGEST
    assert not is_full((*free[1:], known), (known,))
    assert is_full((*free[1:], known), ())
    assert is_full((*free, known), (known,))
