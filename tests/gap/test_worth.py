"""The rule by which a set of effects takes another's place."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.fit.acceptance import is_better
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import CrossFit
from tests.gap.conftest import members

EPISODES = 12
#: Departures of single episodes from a mean, which cancel.
SIGNS = np.tile([-1.0, 1.0], EPISODES // 2)
NAMES = ("joint_damping", "joint_dry_friction", "armature", "actuation_delay")


@pytest.fixture(scope="module")
def fit(arm):
    """The function that makes a set of so many effects by the losses `(E,)` that it leaves, and what it gains."""
    some = members(arm, **dict.fromkeys(NAMES, 0.1))

    def make(names: int, loss, gain: float = 1.0) -> Fit:
        evidence = CrossFit(np.full(EPISODES, gain), np.broadcast_to(loss, EPISODES), np.zeros((4, names)))
        return Fit(some[:names], None, evidence)

    return make


@pytest.mark.parametrize(
    ("left", "gain", "more", "spread", "taken"),
    [
        (0.5, 0.2, 0.14, 0.02, True),  # a quarter of what is left
        (0.5, 0.2, 0.10, 0.02, False),  # surely, but a fifth of it
        (0.5, 0.2, 0.14, 0.60, False),  # not sure
        (10.0, 0.2, 0.16, 0.02, True),  # 0.15 floors are worth a name whatever stays
        (10.0, 0.2, 0.14, 0.02, False),
        (10.0, 9.0, 0.40, 0.02, False),  # less than a twentieth of the gain so far
        (10.0, 9.0, 0.50, 0.02, True),
        (0.15, 0.2, 0.02, 0.01, True),  # little is left
        (0.15, 0.2, 0.009, 0.001, False),
        (0.20, 9.0, 0.15, 0.02, True),  # it ends the search
        (0.20, 9.0, 0.08, 0.02, False),  # it leaves most of it
        (0.04, 9.0, 0.039, 0.002, False),  # all of next to nothing
    ],
)
def test_another_name_must_be_worth_it_and_is_given_up_where_it_is_not(fit, left, gain, more, spread, taken):
    few = fit(1, 1 + left, gain)
    many = fit(2, 1 + left - more - spread * SIGNS, gain + more)
    assert is_better(few, many, ()) is taken
    assert is_better(many, few, ()) is not taken


@pytest.mark.parametrize(
    ("tasks", "taken"),
    [
        ("", False),
        ("ab" * 6, True),  # sure in each of two tasks
        ("aabb" * 3, False),
        ("ab" * 5 + "ac", False),  # one episode of a task tells nothing of its spread
    ],
)
def test_a_small_name_that_ends_the_search_is_as_sure_as_it_is_within_tasks(fit, tasks, taken):
    few, many = fit(1, 1.2, gain=9.0), fit(2, 1.05 - 0.2 * SIGNS, gain=9.0)
    assert is_better(few, many, tasks) is taken


@pytest.mark.parametrize(("more", "taken"), [(0.14, True), (0.12, False)])
def test_two_names_must_each_be_worth_it(fit, more, taken):
    assert is_better(fit(1, 1.5, gain=0.2), fit(3, 1.5 - more, gain=0.2), ()) is taken


@pytest.mark.parametrize(("others", "taken"), [(0.03, True), (0.02, False)])
def test_what_one_episode_gains_is_luck(fit, others, taken):
    gained = np.append(np.full(EPISODES - 1, others), 0.9)
    assert is_better(fit(1, 1.15), fit(2, 1.15 - gained), ()) is taken


@pytest.mark.parametrize(("shift", "taken"), [(0.06, True), (0.0, False)])
def test_a_loss_below_the_floor_counts_for_nothing(fit, shift, taken):
    """A tenth of a floor is gained either way; from 1.04 most of it lies below the floor."""
    assert is_better(fit(1, 1.04 + shift, gain=1.5), fit(2, 0.94 + shift, gain=1.5), ()) is taken


@pytest.mark.parametrize(
    ("more", "spread", "taken"),
    [
        (0.12, 0.05, True),
        (0.09, 0.05, False),  # fits are no sharper than a hundredth of the gain
        (0.12, 0.60, False),  # within a standard error
    ],
)
def test_of_as_many_names_those_that_surely_explain_more_are_taken(fit, more, spread, taken):
    best, other = fit(2, 2.0, gain=10.0), fit(2, 2.0 - more - spread * SIGNS, gain=10.0)
    assert is_better(best, other, ()) is taken
    assert not is_better(other, best, ())


def test_two_sets_never_take_each_others_place(fit, rng):
    taken = 0
    for _ in range(200):
        sizes, spread, gains = rng.integers(1, 4, 2), 10 ** rng.uniform(-3, 0), rng.uniform(-0.5, 5.0, 2)
        losses = 1 + rng.uniform(0, 1, (2, 1)) * spread + spread * rng.standard_normal((2, EPISODES))
        a, b = (fit(int(size), loss, gain) for size, loss, gain in zip(sizes, losses, gains, strict=True))
        forth, back = is_better(a, b, "abcd" * 3), is_better(b, a, "abcd" * 3)
        assert not (forth and back)
        assert sizes[0] == sizes[1] or forth != back, "of sets of other sizes one stands"
        taken += forth
    assert 0 < taken < 200
