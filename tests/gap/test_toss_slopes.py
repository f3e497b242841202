"""Slopes of tosses come from rollouts beside all that acts; a signature of another landing would mislead."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate, typical_size
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening.refinement import joint
from candata.gap.screening.set_slopes import WIDTHS, divided, slopes_of

FRICTION = 0.6


@pytest.fixture(scope="module")
def problem(cube, played, planted):
    """Tosses under another cone and less friction, without a library of signatures."""
    world = (*planted("friction_cone", cone="elliptic"), *planted("sliding_friction", scale=FRICTION))
    recs = recordings(cube, played(cube, world, count=8, duration_s=0.5, seed=5))
    made = _problem(Replayer(cube), recs, Streams(0), None, lambda stage: None)
    return replace(made, library=None)


@pytest.fixture(scope="module")
def members(cube):
    cone, friction = candidate("friction_cone", cube), candidate("sliding_friction", cube)
    (elliptic,) = [u for u in (np.zeros(1), np.ones(1)) if cone.setting(u, cube).parameters["cone"] == "elliptic"]
    return (cone, elliptic), (friction, friction.neutral)


def test_they_are_what_rollouts_beside_the_others_show(cube, problem, members):
    world = partial(divided, members)
    z = problem.residuals([problem.setting(members)])[0]
    slope = slopes_of(problem, members, world, z)
    assert slope.shape == (2, *z.shape)
    assert not slope[0].any()  # a choice has none
    c, u = members[1]
    step = WIDTHS[0] * typical_size(c, cube)
    (moved,) = problem.residuals([problem.setting((members[0], (c, u + step)))])
    np.testing.assert_allclose(slope[1], (moved - z) / step, rtol=1e-5, atol=1e-5)


def test_a_joint_fit_of_tosses_finds_the_value(problem, members):
    base = problem.score.loss(problem.nominal)
    found = joint(problem, members, base)
    c, u = found.members[1]
    # Eight tosses with tracker noise: friction shows in how far they slide.
    assert float(c.values(u)[0]) == pytest.approx(FRICTION, rel=0.1)
