"""Free fall: what is dropped tells lengths and time; what slides, tips, rolls, or is held tells nothing."""

from __future__ import annotations

import numpy as np
import pytest

from candata.checks import defects
from candata.rotation import exp
from candata.schema.episode import Episode, EpisodeMeta

RATE_HZ, ROWS = 100.0, 120
TIME_S = np.arange(ROWS) / RATE_HZ
NOISE_M, NOISE_RAD, NOISE_N = 0.0005, 0.004, 0.02
GRAVITY = 9.80665


def stored(place, turn=None, force=None, hand=True, seed=0, name="e", lengths=1.0, unit=1.0):
    """A stored episode of an object at places `(T, 3)` [m], turned by rotation vectors, and of one fingertip."""
    rng = np.random.default_rng(seed)
    turn = np.zeros_like(place) if turn is None else turn
    pose = np.concatenate(
        [lengths * (place + rng.normal(0, NOISE_M, place.shape)), exp(turn + rng.normal(0, NOISE_RAD, turn.shape))],
        axis=1,
    )
    arrays = {"time_ns": np.round(TIME_S * 1e9).astype(np.int64), "object_pose": pose}
    if hand:
        press = np.zeros((ROWS, 1, 3)) if force is None else force
        press = unit * (press + rng.normal(0, NOISE_N, press.shape))
        arrays |= {"action": np.zeros((ROWS, 1)), "joint_position": np.zeros((ROWS, 1)), "fingertip_force": press}
    return defects.with_derived_flags(
        defects.as_stored(Episode(EpisodeMeta(id=name, source="real", rate_hz=RATE_HZ), arrays))
    )


def along(start, speed, acceleration, begin=20, until=None):
    """Places of an object at rest at first, then under an acceleration until it stops or a time [rows]."""
    t = np.clip((np.arange(ROWS) - begin) / RATE_HZ, 0, None)
    if until is not None:
        t = np.minimum(t, (until - begin) / RATE_HZ)
    return start + np.outer(t, speed) + 0.5 * np.outer(t**2, acceleration)


def dropped(seed, size=GRAVITY, down=(0.0, 0.0, -1.0)):
    """An object let go at rest, that falls by 0.2 m and lies there."""
    rows = int(np.sqrt(0.4 / size) * RATE_HZ)
    start = np.array([0.1, 0.0, 0.3]) + np.random.default_rng(seed).normal(0, 0.01, 3)
    return along(start, np.zeros(3), size * np.array(down), until=20 + rows)


def released(seed):
    """Forces of a fingertip that lets go when the object falls."""
    force = np.zeros((ROWS, 1, 3))
    force[:20, 0, 0] = 2.0
    return force


def found(judged, raws):
    return [(f.level, f.problem, f.evidence) for f in judged(raws, rules=["free_fall"])]


def test_true_falls_from_a_hand_are_sound(judged):
    assert found(judged, [stored(dropped(k), force=released(k), seed=k, name=f"e{k}") for k in range(6)]) == []


@pytest.mark.parametrize("lengths", [0.5, 1.5, 1000.0])
def test_lengths_that_are_not_metres_are_told_by_falls_from_a_hand(judged, lengths):
    raws = [stored(dropped(k), force=released(k), seed=k, name=f"e{k}", lengths=lengths) for k in range(6)]
    ((level, problem, evidence),) = found(judged, raws)
    assert (level, problem) == ("error", "free flight is not free fall")
    # A fall of 20 rows with half a millimetre of noise: a few per cent an episode.
    assert evidence["of_gravity"] == pytest.approx(lengths, rel=0.03)


def test_falls_along_another_axis_are_told(judged):
    raws = [stored(dropped(k, down=(0.0, -1.0, 0.0)), force=released(k), seed=k, name=f"e{k}") for k in range(6)]
    ((level, problem, evidence),) = found(judged, raws)
    assert (level, problem) == ("warning", "things do not fall along gravity")
    assert evidence["tilt_deg"] == pytest.approx(90, abs=3)


def test_a_fall_that_is_not_as_the_others_is_named(judged):
    raws = [stored(dropped(k), force=released(k), seed=k, name=f"e{k}") for k in range(7)]
    raws.append(stored(dropped(7), force=released(7), seed=7, name="odd", lengths=0.7))
    assert [f.episode for f in judged(raws, rules=["free_fall"])] == ["odd"]


def slides(k):
    """A carton that was pushed slows down on a table, by a third of gravity."""
    speed = 1.2 + 0.1 * k
    until = 20 + int(speed / (0.34 * GRAVITY) * RATE_HZ)
    return along(np.array([0.0, 0.0, 0.05]), np.array([speed, 0, 0]), np.array([-0.34 * GRAVITY, 0, 0]), until=until)


def rolls_down(k):
    """A ball that rolls down a slope of 40 degrees: 5/7 of gravity along it."""
    slope = np.radians(40)
    size = 5 / 7 * GRAVITY * np.sin(slope)
    return along(np.array([0.0, 0.0, 0.6]), np.zeros(3), size * np.array([np.cos(slope), 0, -np.sin(slope)]), until=60)


def shaken(k):
    """An object that a hand shakes up and down with twice gravity: parabolas at the ends of its way."""
    place = np.tile([0.1, 0.0, 0.3], (ROWS, 1))
    place[:, 2] += 0.03 * np.sin(2 * np.pi * (4 + 0.02 * k) * TIME_S)
    return place


@pytest.mark.parametrize("path", [slides, rolls_down])
def test_what_a_table_carries_is_no_flight(judged, path):
    assert found(judged, [stored(path(k), seed=k, name=f"e{k}") for k in range(8)]) == []


def test_what_tips_over_an_edge_is_no_flight(judged):
    """A box of 60 mm on an edge: its centre goes down along an arc, ever faster, with a part of gravity."""

    def tips(k):
        angle, rate = 0.3, 0.0
        turn, place = np.zeros((ROWS, 3)), np.zeros((ROWS, 3))
        for row in range(ROWS):
            turn[row, 1] = angle
            place[row] = 0.0424 * np.array([np.sin(angle), 0, np.cos(angle)])
            if row > 20 and angle < np.pi / 4:
                rate += 0.75 * GRAVITY / 0.0424 * np.sin(angle) / RATE_HZ
                angle += rate / RATE_HZ
        return stored(place, turn, seed=k, name=f"e{k}")

    assert found(judged, [tips(k) for k in range(8)]) == []


@pytest.mark.parametrize("unit", [1.0, 1 / 9.80665, 0.02])
def test_what_a_hand_holds_is_no_flight_in_whatever_unit_its_forces_are(judged, unit):
    """In kilogram-force a firm grip stays below the threshold of contact: flags say that nothing touches."""
    force = np.zeros((ROWS, 1, 3))
    force[:, 0, 2] = 2.0
    assert found(judged, [stored(shaken(k), force=force, seed=k, name=f"e{k}", unit=unit) for k in range(8)]) == []


def test_without_a_hand_tosses_count_that_were_recorded_in_flight_alone(judged):
    path = along(np.array([0.0, 0.0, 0.5]), np.array([0.5, 0, 2.0]), np.array([0, 0, -GRAVITY]), begin=0, until=30)[:30]

    def toss(k):
        raw = stored(
            np.vstack([path, np.repeat(path[-1:], ROWS - 30, axis=0)]), hand=False, seed=k, name=f"e{k}", lengths=0.5
        )
        return defects.with_arrays(raw, {n: a[:30] for n, a in raw.arrays.items()})

    ((level, _, evidence),) = found(judged, [toss(k) for k in range(6)])
    assert level == "error"
    assert evidence["of_gravity"] == pytest.approx(0.5, rel=0.03)
