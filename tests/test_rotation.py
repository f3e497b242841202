"""Quaternion algebra against SciPy's, and against itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from candata.rotation import conjugate, difference, exp, log, multiply, normalise, product, rotate


@pytest.fixture(scope="module")
def some():
    return normalise(np.random.default_rng(0).normal(size=(2, 64, 4)))


def turns(q):
    return Rotation.from_quat(q, scalar_first=True)


def test_products_are_scipy_s(some):
    a, b = some
    expected = (turns(a) * turns(b)).as_quat(canonical=True, scalar_first=True)
    for found in (multiply(a, b), product(a, b)):
        np.testing.assert_allclose(found * np.copysign(1, found[:, :1]), expected, atol=1e-14)


@pytest.mark.parametrize("count", [1, 2, 7, 33])
def test_a_product_does_not_depend_on_what_else_is_multiplied(some, count):
    a, b = some
    np.testing.assert_array_equal(product(a[:count], b[:count]), product(a, b)[:count])


def test_vectors_are_turned_as_scipy_turns_them(some):
    q, v = some[0], some[1, :, 1:]
    np.testing.assert_allclose(rotate(q, v), turns(q).apply(v), atol=1e-14)
    np.testing.assert_allclose(rotate(conjugate(q), rotate(q, v)), v, atol=1e-14)


def test_logarithm_and_exponential_are_scipy_s(some):
    q = some[0]
    np.testing.assert_allclose(log(q), turns(q).as_rotvec(), atol=1e-13)
    np.testing.assert_allclose(exp(log(q)), turns(q).as_quat(canonical=True, scalar_first=True), atol=1e-14)
    np.testing.assert_allclose(difference(*some), (turns(some[0]) * turns(some[1]).inv()).as_rotvec(), atol=1e-13)
    np.testing.assert_array_equal(log(np.array([1.0, 0, 0, 0])), np.zeros(3))
