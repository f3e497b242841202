"""The tracker's length scale from free fall and rest: planted scales come back, other causes are told apart."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.data.recordings import Recordings, recordings
from candata.gap.fit.length_scale import (
    SYSTEMATIC,
    Scale,
    _causes,
    length_scale,
    scale_from_flight,
    scale_from_rest,
)
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.replay.starts import starts
from candata.gap.run.streams import Streams
from candata.policies import policy
from candata.simulate import rollout
from candata.simulate.episodes import add_noise

#: The built-in throw ends while the cube still slides; 1.2 s bring it to rest.
COUNT, ROWS = 16, 178


@pytest.fixture(scope="module")
def tossed(cube):
    """The function that records tosses in a world from release to rest."""

    def toss(effects=(), count: int = COUNT) -> Recordings:
        rng = np.random.default_rng(8)
        plans = [policy("toss").plan(cube, rng, 0.8) for _ in range(count)]
        start = (np.stack([getattr(p, n) for p in plans]) for n in ("qpos", "qvel"))
        commands = np.zeros((count, ROWS, 0))
        played = rollout(cube, commands, *start, [effects] * count)
        readings = add_noise(played.readings, cube.file.noise, rng)
        ids = tuple(str(i) for i in range(count))
        return Recordings(ids, ids, commands, readings, np.full(count, ROWS), False)

    return toss


@pytest.fixture(scope="module")
def seen(cube, tossed):
    """The function that reads the length scale off tosses of a world."""

    def look(effects=(), count: int = COUNT):
        recs = tossed(effects, count)
        return length_scale(cube, recs, starts(cube, recs), Streams(2))

    return look


@pytest.mark.parametrize("scale", [0.978, 1.03])
def test_a_planted_length_scale_is_read_off_fall_and_rest(seen, planted, scale):
    found = seen(planted("pose_scale", scale=scale))
    assert found.causes == ("pose_scale",)
    # The scene's noise is 0.5 mm: 16 flights of 0.1 s give the fall to about one per cent, the rest is finer.
    assert found.flight.value == pytest.approx(scale, abs=0.02)
    assert found.rest.value == pytest.approx(scale, abs=0.003)
    assert found.scale.low <= scale <= found.scale.high


def test_a_smaller_object_lies_low_but_falls_as_ever(seen, planted):
    found = seen(planted("object_size", scale=0.95))
    assert found.flight.holds(1.0)
    assert found.rest.value == pytest.approx(0.95, abs=0.003)
    assert "object_size" in found.causes
    assert "pose_scale" not in found.causes
    assert found.scale is None


def test_right_lengths_have_no_cause(seen):
    found = seen()
    assert found.causes == ()
    assert found.flight.holds(1.0)
    assert found.rest.holds(1.0)


def test_too_few_tosses_tell_nothing(seen):
    found = seen(count=7)
    assert (found.flight, found.rest, found.causes, found.scale) == (None, None, (), None)


def test_a_scene_with_a_hand_tells_nothing(hand, played):
    recs = recordings(hand, played(hand, count=1, duration_s=0.3))
    rng = np.random.default_rng(0)
    assert scale_from_flight(hand, recs, starts(hand, recs), rng) is None
    assert scale_from_rest(hand, recs, rng) is None


def test_a_toss_that_is_cut_before_it_rests_or_has_gaps_counts_for_less(cube, tossed):
    recs = tossed()
    begin = starts(cube, recs)
    recs.readings["object_pose"][:10, -3:] = np.nan
    recs.readings["object_pose"][2, 1:4] = np.nan
    found = length_scale(cube, recs, begin, Streams(0))
    assert found.rest is None
    assert found.flight.holds(1.0)


def _at(value: float) -> Scale:
    return Scale(value, value - SYSTEMATIC, value + SYSTEMATIC, 9)


@pytest.mark.parametrize(
    ("flight", "rest", "causes"),
    [
        (_at(0.98), _at(0.981), ("pose_scale",)),
        (_at(0.98), _at(1.0), ("clock_drift",)),
        (_at(0.98), _at(0.95), ("pose_scale", "object_size")),
        (None, _at(0.95), ("pose_scale", "object_size", "support_height", "pose_bias")),
        (_at(0.95), None, ("pose_scale", "clock_drift")),
        (None, None, ()),
    ],
)
def test_what_explains_both_readings(flight, rest, causes):
    assert _causes(flight, rest) == causes


def test_measured_lengths_enter_the_search_before_any_fit(cube, tossed, planted):
    recs = tossed(planted("pose_scale", scale=0.97))
    problem = _problem(Replayer(cube), recs, Streams(0), None, lambda stage: None)
    ((c, u),) = problem.measured
    assert c.name == "pose_scale"
    assert float(c.values(u)[0]) == pytest.approx(0.97, abs=0.003)
    assert problem.ruled_out == {"object_size", "support_height", "pose_bias", "clock_drift"}
    assert "the tracker's lengths are 0.9" in problem.recs.notes[-1]


def test_right_lengths_rule_nothing_out(cube, tossed):
    problem = _problem(Replayer(cube), tossed(), Streams(0), None, lambda stage: None)
    assert (problem.measured, problem.ruled_out) == ((), frozenset())
