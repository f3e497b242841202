"""Sets whose signatures add up: found without a simulation, and taken where they explain most of what is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Curve, Plane
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening.episodes import brief
from candata.gap.screening.look import as_simulated, look
from candata.gap.screening.refinement import joint
from candata.gap.screening.sums import beside, sums
from candata.gap.validation.closure import shares

TRUE = {"joint_dry_friction", "actuation_delay"}


@pytest.fixture(scope="module")
def posed(arm, arm_episodes, planted, tmp_path_factory):
    """The problem that an arm with two causes poses, and a look at every effect alone."""
    effects = (*planted("joint_dry_friction", frictionloss_Nm=0.3), *planted("actuation_delay", delay_s=0.03))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), tmp_path_factory.mktemp("kept"), lambda stage: None, share=True)
    return problem, look(problem)


def names(members):
    return {c.name for c, _ in members}


def test_the_true_pair_leaves_least_and_nothing_is_simulated(posed, monkeypatch):
    problem, first = posed
    part, _ = brief(problem)
    monkeypatch.setattr(Problem, "_simulated", lambda *a: pytest.fail("it was simulated"))
    pairs, triples = sums(part, first.rough)
    assert names(pairs[0].members) == TRUE
    assert [len(one.members) for one in (pairs[0], triples[0])] == [2, 3]
    assert all(len(names(one.members)) == len(one.members) for one in (*pairs, *triples))
    assert [one.loss for one in pairs] == sorted(one.loss for one in pairs)


def test_signatures_that_add_up_give_their_coordinates(arm, posed):
    """Two effects that each clear half of the residuals, a scalar and a vector, and one that clears most of them."""
    problem, _ = posed
    part, _ = brief(problem)
    z = part.nominal
    rng = np.random.default_rng(1)
    half, most = rng.random(z.shape) < 0.5, rng.random(z.shape) < 0.7
    damping, offset, armature = (candidate(name, arm) for name in ("joint_damping", "joint_offset", "armature"))
    to, at = 0.4, np.array([0.05, -0.08])
    grid = np.array([0.0, 0.2, 0.8])

    def curve(c, cleared, to):
        return c, Curve(c, grid, np.stack([z * (1 - cleared * u / to) for u in grid]), np.array([True, False, False]))

    each = np.stack([-z * ~half * np.array([i % 2 == k for i in range(z.shape[1])]) / at[k] for k in range(2)])
    plane = offset, Plane(offset.low, offset.high, offset.neutral, z, each.astype(np.float32))
    pairs, _ = sums(part, [curve(armature, most, 0.5), curve(damping, half, to), plane])
    (_, scalar), (_, vector) = pairs[0].members
    assert names(pairs[0].members) == {"joint_damping", "joint_offset"}
    assert scalar == pytest.approx([to], rel=0.05)
    assert vector == pytest.approx(at, rel=0.05)
    assert pairs[0].loss < 0.02 < pairs[1].loss


def test_a_choice_is_taken_at_its_best(arm, posed):
    problem, _ = posed
    part, _ = brief(problem)
    step = candidate("time_step", arm)
    values = step.neutral[0] + np.array([-0.7, 0.0, 0.7])
    cleared = np.stack([part.nominal * share for share in (0.8, 1.0, 0.3)])
    choice = step, Curve(step, values, cleared, np.ones(3, bool))
    armature = candidate("armature", arm)
    idle = armature, Curve(armature, np.array([0.0, 1.0]), np.stack([part.nominal] * 2), np.ones(2, bool))
    pairs, triples = sums(part, [choice, idle])
    assert dict((c.name, u[0]) for c, u in pairs[0].members)["time_step"] == values[2]
    assert triples == []


def test_a_fit_begins_beyond_a_rise_where_slopes_at_the_neutral_value_lead_away(arm, posed):
    """Contact that comes and goes: a little of an effect makes it worse, and much of it clears all."""
    part, _ = brief(posed[0])
    z = part.nominal
    armature = candidate("armature", arm)
    grid = armature.neutral + np.array([0.0, 0.4, 0.9]) * (armature.high - armature.neutral)
    curve = Curve(armature, grid, np.stack([z, 1.5 * z, 0 * z]), np.ones(3, bool))
    (one,) = beside(part, z, [], [(armature, curve)])
    assert one.members[0][1] == pytest.approx([grid[2]], rel=0.1)
    assert one.loss < 0.1


@pytest.fixture
def making_up(arm, posed):
    """A few episodes, a held damping that makes up for what is missing, its true place, and residuals in halves."""
    part, _ = brief(posed[0])
    z = part.nominal
    half = np.random.default_rng(1).random(z.shape) < 0.5
    mine, others = z * half, z * ~half
    damping = candidate("joint_damping", arm)
    at, to = (damping.low + share * (damping.high - damping.low) for share in (0.2, 0.6))
    slope = (2 * others - 3 * mine)[None] / np.float32(to - at)[0]
    return part, (damping, Plane(damping.low, damping.high, at, z, slope)), to, mine, others


def test_what_is_held_moves_along_with_another_effect(arm, making_up):
    """What is held makes up for the other one, which leaves half where it stands; both moved clear all."""
    part, held, to, mine, others = making_up
    z = part.nominal
    armature, delay = (candidate(n, arm) for n in ("armature", "actuation_delay"))

    def curve(c, moved):
        grid = c.neutral + np.linspace(0, 1, 11) * (c.high - c.neutral)
        return c, Curve(c, grid, np.stack([z + moved * u for u in np.linspace(0, 2, 11)]), np.ones(len(grid), bool))

    missing, idle = curve(armature, 2 * mine - 3 * others), curve(delay, 0 * z)
    assert missing[1].table(part.score).mean(1).min() > 0.5 * float(part.score.loss(z).mean())
    found = beside(part, z, [held], [idle, missing])
    (_, moved), (_, joined) = found[0].members
    assert names(found[0].members) == {"joint_damping", "armature"}
    assert moved == pytest.approx(to, rel=0.05)
    assert joined == pytest.approx((armature.neutral + armature.high) / 2, rel=0.05)
    assert found[0].loss < 0.02
    assert all("actuation_delay" not in names(one.members) for one in found), "one at its neutral value is no other"


def test_each_value_of_a_choice_is_tried_with_what_is_held_moved_along(arm, making_up):
    """Where the held effect stands one value clears more; moved along, only the other value clears all."""
    part, held, to, mine, others = making_up
    z = part.nominal
    step = candidate("time_step", arm)
    values = step.neutral[0] + np.array([-0.7, 0.0, 0.7])
    shown = np.stack([z - 0.9 * others, z, z + 2 * mine - 3 * others])
    choice = step, Curve(step, values, shown, np.ones(3, bool))
    first, last = (float(part.score.loss(residuals).mean()) for residuals in shown[[0, 2]])
    assert first < last
    found, other = beside(part, z, [held], [choice])
    assert found.members[1][1] == pytest.approx([values[2]])
    assert other.members[1][1] == pytest.approx([values[0]]), "what is read off may be wrong of either"
    assert found.members[0][1] == pytest.approx(to, rel=0.05)
    assert found.loss < 0.02


@pytest.fixture(scope="module")
def right(arm, posed):
    """A fit of the two true causes."""
    problem, _ = posed
    values = {"joint_dry_friction": 0.3, "actuation_delay": 0.03}
    members = tuple((candidate(name, arm), np.full(1, value)) for name, value in values.items())
    return joint(problem, members, problem.score.loss(problem.nominal))


def test_what_was_simulated_on_the_recording_replaces_its_chord(posed):
    """The sum of two effects is read off these curves: its error is theirs."""
    problem, first = posed
    part, _ = brief(problem)
    rough, better = dict_of(first.rough), dict_of(as_simulated(problem, first))
    assert list(better) == list(rough)
    fit = first.fits[0]
    ((c, _),) = fit.members
    u = fit.curve.at[fit.curve.sure][-1:]
    assert not c.is_neutral(u)
    (there,) = part.residuals([part.setting([(c, u)])])
    error, before = (np.abs(some[c.label].read(u) - there).mean() for some in (better, rough))
    assert error < 1e-5 < 0.02 < before
    assert better[c.label].z.shape[1] == len(part.recs)
    untouched = [label for label in rough if label not in {f.labels[0] for f in first.fits}]
    assert untouched
    assert all(better[label] is rough[label] for label in untouched)


def dict_of(responses):
    """The responses by label."""
    return {c.label: r for c, r in responses}


def test_a_rival_that_is_as_good_takes_support_from_what_it_exchanges(arm, posed, right):
    problem, _ = posed
    sure = dict(zip(right.labels, shares(problem, right), strict=True))
    assert all(support > 0.99 for _, support in sure.values())
    luck = np.tile([-0.1, 0.1], 6)
    rival = replace(right, members=((candidate("joint_damping", arm), np.full(1, 0.3)), right.members[1]))
    rival = replace(rival, evidence=replace(right.evidence, loss=right.evidence.loss + luck))
    found = dict(zip(right.labels, shares(problem, right, [rival]), strict=True))
    assert found["actuation_delay"] == sure["actuation_delay"]
    assert 0.3 < found["joint_dry_friction"][1] < 0.7


def test_an_alias_that_loses_by_less_than_fits_are_sharp_takes_half_the_support(arm, posed, right):
    problem, _ = posed
    own = rises(problem, right)["joint_dry_friction"]
    alias = replace(right, members=((candidate("joint_damping", arm), np.full(1, 0.3)), right.members[1]))
    for share, least, most in ((0.0005, 0.45, 0.6), (0.05, 0.99, 1.0)):
        loss = right.evidence.loss + share * own
        rival = replace(alias, evidence=replace(right.evidence, loss=loss))
        found = dict(zip(right.labels, shares(problem, right, [rival]), strict=True))
        assert least < found["joint_dry_friction"][1] <= most


def rises(problem, fit):
    """By how much the mean loss rises without each member."""
    own = problem.score.loss(fit.plane.z).mean()
    without = [problem.score.loss(z).mean() - own for z in problem.without_each(fit.members)]
    return dict(zip(fit.labels, without, strict=True))
