"""What a report draws beyond the record, against values worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.fit.candidates import candidate
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import CrossFit
from candata.gap.fit.response import Curve, Plane
from candata.gap.measure.floor import Floor
from candata.gap.measure.score import score
from candata.gap.validation.closure import HeldOut
from candata.gap.verdict.exhibits import COURSES, POINTS, change, collinearity, elements, ranges
from candata.schema.report import Estimate, NamedEffect

NO_EVIDENCE = CrossFit(np.zeros(4), np.zeros(4), np.zeros((4, 1)))


@pytest.fixture
def problem(arm, one_phase, plain_recordings):
    """Four episodes of 300 rows of the arm's joints; the nominal replay is off by (k + 1) mrad in episode k."""
    recorded = np.zeros((4, 300, 2))
    recs = plain_recordings(joint_position=recorded)
    plan = one_phase(4, 60, 2)
    before = {"joint_position": recorded - 1e-3 * np.arange(1, 5)[:, None, None] * [1.0, -2.0]}
    after = {"joint_position": before["joint_position"] / 10}
    spread = Floor(np.full((4, 60, 2), 5e-4), np.full((6, 4, 60, 2), 3e-4))
    world = SimpleNamespace(
        plan=plan,
        score=score(np.zeros((4, 60, 2)), spread, plan),
        begin=SimpleNamespace(rows=np.zeros(4, int)),
        replayer=SimpleNamespace(scene=arm),
    )
    return world, HeldOut(recs, before, after, np.ones(4), np.ones(4), np.zeros((4, 1)))


def test_errors_are_those_of_each_element_and_episode(problem):
    found = elements(*problem, repaired=True)
    assert found.ids == ("e0", "e1", "e2", "e3")
    assert [e.label for e in found.of] == ["joint_position j0", "joint_position j1"]
    # Single precision of the normalised residuals.
    assert found.of[0].before == pytest.approx([1e-3, 2e-3, 3e-3, 4e-3], rel=1e-5)
    assert found.of[1].before == pytest.approx([2e-3, 4e-3, 6e-3, 8e-3], rel=1e-5)
    assert found.of[1].after == pytest.approx(found.of[1].before / 10, rel=1e-5)
    assert found.of[0].null == pytest.approx([3e-4] * 4, rel=1e-5)


def test_courses_go_from_the_worst_to_the_best_episode_and_are_thinned(problem):
    courses = elements(*problem, repaired=True).of[1].courses
    assert len(courses) == COURSES
    assert (courses[0].episode, courses[-1].episode) == (3, 0)
    assert len(courses[0].time_s) <= POINTS
    assert courses[0].before == pytest.approx(8e-3)
    assert courses[0].time_s[1] == pytest.approx(3 / 100), "every third of 300 rows at 100 Hz"


def test_without_a_repair_there_is_no_after(problem):
    found = elements(*problem, repaired=False)
    assert all(e.after is None and all(c.after is None for c in e.courses) for e in found.of)


def test_an_element_that_was_never_recorded_has_no_course(problem):
    world, held = problem
    mask = world.score.mask.copy()
    mask[:, ::2] = False
    world.score = replace(world.score, mask=mask)
    first, second = elements(world, held, repaired=True).of
    assert np.isnan(first.before).all()
    assert first.courses == ()
    assert len(second.courses) == COURSES


def curve(scene, name: str, direction: np.ndarray, at: float) -> Fit:
    """A scalar whose residuals move along `direction` with its coordinate, fitted at `at`."""
    c = candidate(name, scene)
    grid = np.array([c.neutral[0], c.neutral[0] + 1, c.neutral[0] + 2])
    z = np.stack([(u - c.neutral[0]) * direction for u in grid]).astype(np.float32)
    return Fit(((c, c.neutral + at),), Curve(c, grid, z, np.ones(3, bool)), NO_EVIDENCE)


def test_cosines_of_what_two_candidates_change(arm):
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 3, 8))
    fits = [
        curve(arm, "joint_dry_friction", a, 0.5),
        curve(arm, "joint_damping", -2 * a, 0.3),
        curve(arm, "armature", b, 1.0),
    ]
    found = collinearity(fits)
    assert found.labels == ("joint_dry_friction", "joint_damping", "armature")
    expected = float((a * b).sum() / np.linalg.norm(a) / np.linalg.norm(b))
    # Single precision of the residuals.
    assert found.matrix == pytest.approx(
        np.array([[1, -1, expected], [-1, 1, -expected], [expected, -expected, 1]]), abs=1e-5
    )


def test_of_one_effect_on_several_elements_the_best_stands_for_all(arm):
    one, other = np.ones((2, 3)), np.eye(2, 3)
    first = curve(arm, "joint_damping", one, 0.5)
    ((c, u),) = first.members
    local = replace(first, members=((replace(c, element="elbow"), u),))
    found = collinearity([first, local, curve(arm, "armature", other, 1.0)])
    assert found.labels == ("joint_damping", "armature")


def test_a_candidate_fitted_to_its_absence_is_read_over_its_grid(arm):
    direction = np.ones((2, 3))
    assert change(curve(arm, "armature", direction, 0.0)) == pytest.approx(2 * direction)


def test_a_vector_changes_along_the_direction_it_was_fitted_with(arm):
    c = candidate("joint_offset", arm)
    slope = np.stack([np.full((2, 3), 1.0), np.full((2, 3), 10.0)]).astype(np.float32)
    plane = Plane(c.low, c.high, c.neutral, np.zeros((2, 3), np.float32), slope)
    found = change(Fit(((c, c.neutral + np.array([0.02, -0.01])),), plane, NO_EVIDENCE))
    assert found == pytest.approx(np.full((2, 3), 0.02 - 0.1), rel=1e-5)


def test_one_candidate_or_still_ones_have_no_cosine(arm):
    assert collinearity([curve(arm, "armature", np.ones((2, 3)), 1.0)]) is None
    assert collinearity([curve(arm, "armature", np.zeros((2, 3)), 1.0)] * 2) is None


def test_ranges_are_the_effects_own_in_this_scene(arm):
    def named(name: str, **values) -> NamedEffect:
        return NamedEffect(name=name, share=1, support=1, parameters={k: Estimate(value=v) for k, v in values.items()})

    found = ranges(
        [
            named("servo_gain", kp_scale=0.5),
            named("friction_cone", cone="elliptic"),
            named("torque_limit", limit_Nm=1.0),
        ],
        arm,
    )
    assert set(found) == {("servo_gain", None, "kp_scale"), ("torque_limit", None, "limit_Nm")}
    gain = found["servo_gain", None, "kp_scale"]
    assert (gain.low, gain.high, gain.identity) == (0.1, 8.0, 1.0)
    assert found["torque_limit", None, "limit_Nm"].identity is None
