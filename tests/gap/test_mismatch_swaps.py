"""Exchanged joints: an encoder's offset that shows only under a touch is no exchange, other motions are one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from candata.gap.mismatch.swaps import confirmed, distances, ordered

#: Four episodes of two joints: in the last two, fingers are stopped and the commands lie near each other.
TIME = np.linspace(0, 3, 100)
APART = (0.3, 0.3, 0.04, 0.04)
GIVEN = np.stack([np.stack([0.1 * np.sin(4 * TIME), a + 0.1 * np.sin(4 * TIME)], 1) for a in APART])
EXCHANGE = np.array([1, 0])


def judged(joint: np.ndarray, own: np.ndarray):
    """What is said of an exchange where the scene's joints go as commanded, or as the exchanged commands say."""
    return confirmed(SimpleNamespace(joint=joint), EXCHANGE, own, own[..., EXCHANGE], own)


def test_offsets_that_show_under_a_touch_are_no_exchange():
    touched = GIVEN.copy()
    touched[2:] += [0.03, -0.03]
    as_recorded, exchanged = (distances(touched - v, np.ones(2, bool)) for v in (GIVEN, GIVEN[..., EXCHANGE]))
    assert (2 * exchanged[2:] < as_recorded[2:]).all()  # which comes much closer there
    assert judged(touched, GIVEN) is None


def test_joints_that_move_as_the_others_command_are_exchanged_whatever_their_offsets():
    own = GIVEN.copy()
    own[..., 1] += 0.2 * np.cos(7 * TIME)
    found = judged(ordered(own, EXCHANGE) + np.array([0.01, -0.01]), own)
    assert found is not None
    assert all(found.episodes)
    some = own.copy()
    some[:2] = ordered(own, EXCHANGE)[:2]
    assert judged(some, own).episodes == (True, True, False, False)


def test_a_dead_joint_is_not_exchanged_with_a_small_one():
    """The small one, asked to go as far as the other, stops at its range: nearer to it than the dead one to its own."""
    far, small = 0.5 + 0.5 * np.sin(4 * TIME), 0.05 * np.sin(3 * TIME)
    own = np.repeat(np.stack([far, small], 1)[None], 4, axis=0)
    dead = np.stack([np.zeros_like(own[..., 0]), own[..., 1]], 2)
    commanded = np.stack([own[..., 1], np.minimum(own[..., 0], 0.1)], 2)
    away, closer = (distances(dead - v, np.ones(2, bool)) for v in (own, commanded))
    assert (closer < 0.5 * away).all()
    assert confirmed(SimpleNamespace(joint=dead), EXCHANGE, own, commanded, own) is None
