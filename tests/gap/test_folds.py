"""Cross-fitting: each episode is held out once, and what is held out has no say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.gap.fit.candidates import Candidate
from candata.gap.fit.folds import FOLDS, cross_fit, folds, null_threshold, rest
from candata.gap.fit.response import Curve, Plane

E, K = 12, 60


def curve(level, rng, strength: float = 0.5) -> Curve:
    """A scalar whose residuals move along a random direction, neutral at 0."""
    at = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    who = Candidate(
        "joint_damping", None, np.zeros(1), at[:1], at[-1:], np.zeros(1, bool), False, np.ones(1, bool), np.zeros(1)
    )
    direction = strength * rng.standard_normal((E, K))
    z = (level.null[0] + at[:, None, None] * direction).astype(np.float32)
    return Curve(who, at, z, np.ones(len(at), bool))


def plane(level, rng, size: int = 4, strength: float = 0.5) -> Plane:
    """A vector whose residuals move along random directions."""
    slope = strength * rng.standard_normal((size, E, K)).astype(np.float32)
    return Plane(np.full(size, -2.0), np.full(size, 2.0), np.zeros(size), level.null[0], slope)


@given(st.lists(st.sampled_from("abcde"), min_size=8, max_size=60), st.integers(0, 2**32 - 1))
def test_every_episode_is_held_out_once_and_tasks_are_balanced(tasks, seed):
    parts = folds(tuple(tasks), np.random.default_rng(seed))
    assert len(parts) == FOLDS
    assert sorted(np.concatenate(parts).tolist()) == list(range(len(tasks)))
    for task in set(tasks):
        counts = [sum(tasks[i] == task for i in p) for p in parts]
        # As even as whole numbers allow.
        assert max(counts) - min(counts) <= 1
    sizes = [len(p) for p in parts]
    assert max(sizes) - min(sizes) <= 1


@given(st.integers(8, 40), st.integers(0, 2**32 - 1))
def test_training_and_test_part_the_episodes(count, seed):
    parts = folds(("",) * count, np.random.default_rng(seed))
    for fold, test in enumerate(parts):
        train = rest(parts, fold)
        assert not set(train) & set(test)
        assert len(train) + len(test) == count


def test_folds_differ_with_the_generator():
    drawn = {str(folds(("",) * 16, np.random.default_rng(seed))) for seed in range(5)}
    assert len(drawn) == 5


@pytest.mark.parametrize("kind", [curve, plane])
@pytest.mark.parametrize("fold", range(FOLDS))
def test_held_out_episodes_have_no_say_in_the_fit(white_score, rng, kind, fold):
    level = white_score(rng, E, K)
    response, parts = kind(level, rng), folds(("a", "b") * (E // 2), rng)
    base = level.loss(level.null[0])
    before = cross_fit(response, level, parts, base)
    z = response.z.copy()
    z[..., parts[fold], :] += 5 * rng.standard_normal(z[..., parts[fold], :].shape).astype(np.float32)
    after = cross_fit(replace(response, z=z), level, parts, base)
    assert np.array_equal(before.points[fold], after.points[fold])
    others = [f for f in range(FOLDS) if f != fold]
    assert not np.array_equal(before.points[others], after.points[others]), "they train the other folds"


def test_the_gain_is_what_the_loss_falls(white_score, rng):
    level = white_score(rng, E, K)
    base = rng.uniform(1, 2, E)
    found = cross_fit(curve(level, rng), level, folds(("",) * E, rng), base)
    np.testing.assert_allclose(found.gain, base - found.loss, atol=1e-12)


def test_a_planted_scalar_is_found_by_every_fold(white_score, rng):
    level = white_score(rng, E, K)
    clean = curve(level, rng, strength=2.0)
    # The recording holds the effect at 1: the residual is the null at 1, and grows away from it.
    moved = replace(clean, z=np.roll(clean.z, 1, axis=0)[1:], at=clean.at[1:])
    found = cross_fit(moved, level, folds(("",) * E, rng), level.loss(moved.read(np.zeros(1))))
    # 540 training values of slope 2 know the point to 0.02.
    np.testing.assert_allclose(found.points, 1.0, atol=0.06)
    assert found.gain.mean() > 0.5


def best_gain(responses, level, parts, z) -> float:
    """Largest mean held-out gain when the recording is `z`: each response moved onto it."""
    gains = []
    for r in responses:
        offset = z - (r.neutral() if isinstance(r, Curve) else r.z)
        gains.append(cross_fit(replace(r, z=r.z + offset), level, parts, level.loss(z)).gain.mean())
    return max(gains)


def test_null_gains_stay_below_the_threshold(white_score):
    rng = np.random.default_rng(11)
    level = white_score(rng, E, K)
    responses = [curve(level, rng) for _ in range(4)] + [plane(level, rng)]
    parts = folds(("",) * E, rng)
    threshold = null_threshold(responses, level, parts, np.zeros((1, E)), rng)
    fresh = rng.standard_normal((200, E, K)).astype(np.float32)
    gains = np.array([best_gain(responses, level, parts, z) for z in fresh])
    # One in a hundred is meant; 200 draws and a threshold from 240 sets make up to 4 % of that.
    assert (gains > threshold).mean() <= 0.04
    # It is not out of reach either: the largest null gains come near it.
    assert threshold < 3 * np.quantile(gains, 0.99)


def test_an_effect_beats_the_threshold(white_score):
    rng = np.random.default_rng(12)
    level = white_score(rng, E, K)
    responses = [curve(level, rng) for _ in range(4)]
    parts = folds(("",) * E, rng)
    threshold = null_threshold(responses, level, parts, np.zeros((1, E)), rng)
    moved = level.null[1] + responses[2].z[3] - responses[2].z[2]
    assert best_gain(responses, level, parts, moved) > 5 * threshold
    assert best_gain(responses, level, parts, level.null[1]) <= threshold


def test_luck_raises_the_threshold(white_score):
    rng = np.random.default_rng(13)
    level = white_score(rng, E, K)
    responses, parts = [curve(level, rng) for _ in range(3)], folds(("",) * E, rng)
    luck = rng.standard_normal((8, E))
    calm, lucky = (null_threshold(responses, level, parts, a * luck, np.random.default_rng(1)) for a in (0.0, 1.0))
    # The mean of 12 draws has spread 0.29; the best of three, one time in a hundred, lies near 2.7 of those.
    assert 0.4 < lucky - calm < 1.2


def test_a_vector_has_the_luck_of_many_trials(white_score):
    rng = np.random.default_rng(14)
    level, luck, parts = white_score(rng, E, K), rng.standard_normal((8, E)), folds(("",) * E, rng)
    one, many = (
        null_threshold([r], level, parts, luck, np.random.default_rng(1))
        for r in (curve(level, rng), plane(level, rng))
    )
    # The best of eight means of 12 draws against one of them, both one time in a hundred: 3.1 spreads against 2.3.
    assert many > one


def test_without_candidates_nothing_is_gained(white_score, rng):
    level = white_score(rng, E, K)
    assert null_threshold([], level, folds(("",) * E, rng), np.zeros((1, E)), rng) == 0.0
