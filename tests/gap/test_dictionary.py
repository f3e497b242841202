"""Sparse regression of a force on a dictionary: the right terms, no more, and none for noise."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.force.dictionary import Sample, alternatives, describe_force, fitted, held_out_gain

GROUPS = tuple((k,) for k in range(6))
PARTS = [np.arange(8)[f::4] for f in range(4)]


@pytest.fixture
def noise(rng):
    """Eight episodes of twenty blocks along two axes, with six terms, and noise of one newton."""
    terms = rng.standard_normal((8, 20, 2, 6))
    terms[..., 0] = 1.0
    return Sample(rng.standard_normal((8, 20, 2)), terms, GROUPS, np.ones(2))


def planted(noise: Sample, force: np.ndarray) -> Sample:
    return Sample(noise.force + force, noise.terms, noise.groups, noise.sigma)


def test_two_planted_terms_are_found_with_their_size(noise):
    force = 2.0 * noise.terms[..., 3] - 1.0 * noise.terms[..., 5]
    found = describe_force(planted(noise, force), PARTS)
    assert found.terms == (3, 5)
    # 160 blocks of unit noise tell a coefficient to 0.08; three of these.
    np.testing.assert_allclose(found.coefficients, [[2, 2], [-1, -1]], atol=0.24)
    assert (found.gain > 0).all()


def test_noise_takes_no_terms(noise):
    found = describe_force(noise, PARTS)
    assert found.terms == ()
    assert (found.gain == 0).all()


def test_a_term_that_fits_one_episode_is_not_taken(noise):
    force = np.zeros_like(noise.force)
    force[0] = 4.0 * noise.terms[0, ..., 3]
    assert describe_force(planted(noise, force), PARTS).terms == ()


def test_the_plainest_of_equals_is_taken(noise):
    terms = noise.terms.copy()
    terms[..., 2] = 1 + 0.01 * terms[..., 2]
    sample = Sample(noise.force + 2.0, terms, GROUPS, noise.sigma)
    assert describe_force(sample, PARTS).terms[0] == 0


def test_terms_of_a_group_come_together(noise):
    sample = planted(noise, 2.0 * noise.terms[..., 3])
    grouped = Sample(sample.force, sample.terms, ((0,), (3, 4)), sample.sigma)
    assert describe_force(grouped, PARTS).terms == (3, 4)


def test_what_was_not_seen_is_left_out(noise):
    force = 2.0 * noise.terms[..., 3]
    sample = planted(noise, force)
    holes = sample.force.copy()
    holes[:, ::3] = np.nan
    found = describe_force(Sample(holes, sample.terms, GROUPS, sample.sigma), PARTS)
    assert found.terms == (3,)
    nothing = Sample(np.full_like(holes, np.nan), sample.terms, GROUPS, sample.sigma)
    assert describe_force(nothing, PARTS).terms == ()


def test_an_outlier_hardly_moves_a_coefficient(noise):
    sample = planted(noise, 2.0 * noise.terms[..., 3])
    sample.force[0, 0] += 500.0
    # As without the outlier.
    np.testing.assert_allclose(fitted(sample, (3,)), [[2, 2]], atol=0.24)


def test_held_out_gain_sees_only_the_other_folds(noise):
    sample = planted(noise, 2.0 * noise.terms[..., 3])
    other = Sample(sample.force.copy(), sample.terms, GROUPS, sample.sigma)
    other.force[PARTS[0]] *= -1
    first, second = (held_out_gain(s, [PARTS[0]], (3,)) for s in (sample, other))
    assert (first[PARTS[0]] > 0).all()
    assert (second[PARTS[0]] < 0).all()


def test_alternatives_are_those_that_held_out_episodes_do_not_tell_from_the_best(noise):
    # Two terms that are nearly the same, and one that explains a part of them.
    noise.terms[..., 3] = noise.terms[..., 5] + 0.05 * noise.terms[..., 3]
    sample = planted(noise, 2.0 * noise.terms[..., 5])
    chosen = describe_force(sample, PARTS).terms
    others = alternatives(sample, PARTS, chosen)
    assert {chosen[0], *(k for d in others for k in d.terms)} == {3, 5}
    assert all(d.terms != chosen and d.gain.sum() > 0 for d in others)
