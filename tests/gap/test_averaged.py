"""Faint effects are found in the mean over replays that chaos deals other outcomes; null worlds are not named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap import diagnosis
from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate, local_candidates
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import CrossFit
from candata.gap.fit.stage import Stage
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.pace import Pace
from candata.gap.run.streams import Streams
from candata.gap.screening.episodes import brief
from candata.gap.screening.signature_screen import respond
from candata.gap.search import attribution, replay_means
from candata.gap.search.replay_means import Averaged, faint, placed
from candata.scenes import load_scene

#: The fault that one replay hides: one fingertip's rolling friction [m], at a place of the range it is drawn from.
ROLLING_M, TIP = 0.0035, "left_tip"


@pytest.fixture(scope="module")
def gripper():
    return load_scene("gripper_tabletop")


@pytest.fixture(scope="module")
def posed(gripper, played):
    """The function that poses the problem of recordings, and a first look at the effects named."""

    def make(effects, *names, count=20, duration_s=2.4):
        recs = recordings(gripper, played(gripper, effects, count=count, duration_s=duration_s))
        problem = _problem(Replayer(gripper), recs, Streams(0), None, lambda stage: None)
        part, _ = brief(problem)
        responses, _ = respond(part, part.nominal, [candidate(n, gripper) for n in names])
        base = problem.score.loss(problem.nominal)
        return problem, Stage(base, np.zeros((1, len(base))), (), 0.02, (), (), (), 0.97, responses)

    return make


@pytest.fixture(scope="module")
def hidden(posed, planted):
    """A problem of one fingertip's rolling friction, and the look at that effect."""
    return posed(planted("rolling_friction", TIP, rolling_m=ROLLING_M), "rolling_friction")


@pytest.fixture(scope="module")
def shown(hidden):
    """What the mean over replays shows of that friction, and the steps that were told meanwhile."""
    problem, first = hidden
    said = []
    return faint(replace(problem, pace=Pace(said.append)), first), said


@pytest.fixture(scope="module")
def null(posed):
    return posed((), "rolling_friction", "torsional_friction")


def test_a_fault_of_one_fingertip_that_one_replay_hides_is_found_there(hidden, shown):
    _, first = hidden
    assert first.base.mean() - 1 < attribution.HIDDEN, "a gap as small as nulls have"
    (fit, many), said = shown
    assert said == ["looking for what contact hides, in the mean over many replays"]
    assert fit.labels == (f"rolling_friction {TIP}",)
    assert np.exp(fit.members[0][1][0]) == pytest.approx(ROLLING_M, rel=0.5)
    assert fit.gain > replay_means.NAMED
    before, after = replay_means.sizes_in_mean(many, fit)
    assert after.mean() < before.mean()


def test_of_a_null_world_nothing_is_named(null):
    problem, first = null
    assert len(replay_means._quiet(problem, first)) >= 7, (
        "each fingertip's rolling and torsional friction, and the table's"
    )
    assert faint(problem, first) is None


def test_a_null_world_has_one_floor_in_the_mean(null):
    problem, _ = null
    assert Averaged(problem).sizes([None], 8).mean() == pytest.approx(1.0, abs=0.03)


def test_the_mean_varies_less_than_one_replay_does(posed, gripper):
    """What an effect gains over a null: by pairs of replays, and by eight of each."""
    problem, _ = posed((), count=8, duration_s=1.2)
    (c,) = [v for v in local_candidates(candidate("rolling_friction", gripper), gripper) if v.element == TIP]
    point = (c, np.log([0.0025]))
    one, eight = [], []
    for seed in range(4):
        many = Averaged(replace(problem, streams=Streams(seed)))
        nominal, own = (many.losses([m], 8) for m in (None, point))
        eight.append(float((nominal - own).mean()))
        one += [float((many.losses([None], k + 1, k) - many.losses([point], k + 1, k)).mean()) for k in range(8)]
    assert np.std(eight) < 0.6 * np.std(one)


def test_worlds_follow_the_same_noise_and_are_played_once(null, monkeypatch):
    problem, _ = null
    many = Averaged(problem)
    twice = many.losses([None, None], 2)
    assert np.array_equal(twice[0], twice[1])
    assert np.array_equal(Averaged(problem).losses([None], 2), twice[:1])
    assert not np.array_equal(Averaged(replace(problem, streams=Streams(4))).losses([None], 2), twice[:1])
    each = [many.losses([None], k + 1, k)[0] for k in range(2)]
    assert twice[0] == pytest.approx(np.mean(each, axis=0))
    monkeypatch.setattr(replay_means, "replay_all", lambda *a: pytest.fail("played again"))
    many.losses([None], 2)


def test_noise_is_laid_over_what_is_followed_alone(null):
    problem, _ = null
    joints = problem.recs.readings["joint_position"].copy()
    joints[0, 3] = np.nan
    recs = replace(problem.recs, readings=problem.recs.readings | {"joint_position": joints})
    noisy = replay_means._jittered(recs, problem.noise, np.random.default_rng(0)).readings
    joints = noisy["joint_position"] - recs.readings["joint_position"]
    assert np.isnan(noisy["joint_position"][0, 3]).all()
    assert np.nanstd(joints) == pytest.approx(problem.noise.joint_position, rel=0.05)
    shift = (noisy["object_pose"] - recs.readings["object_pose"])[..., :3]
    assert shift.std() == pytest.approx(problem.noise.object_pose[0], rel=0.05)
    assert np.linalg.norm(noisy["object_pose"][..., 3:], axis=-1) == pytest.approx(1.0)
    assert noisy["fingertip_force"] is recs.readings["fingertip_force"]
    arm = replace(recs, readings={"joint_position": recs.readings["joint_position"]})
    assert set(replay_means._jittered(arm, problem.noise, np.random.default_rng(0)).readings) == {"joint_position"}


class Told:
    """Losses that are told: `(of replays that choose, of those that decide)` by element, 1.0 of the nominal world."""

    def __init__(self, problem, gains):
        self.problem, self.gains = problem, gains

    def losses(self, members, copies, first=0):
        count = len(self.problem.recs)
        some = [0.0 if m is None else self._gain(m, first) for m in members]
        return np.array([np.full(count, 1.0 - gain) for gain in some])

    def _gain(self, member, first):
        c, u = member
        best, decides = self.gains[c.element]
        return (decides if first else best) - 0.1 * (u[0] - np.log(0.003)) ** 2


def test_what_chose_a_value_does_not_decide(null, gripper):
    """The luckiest of the replays that choose comes second where others decide."""
    problem, _ = null
    tips = {v.element: v for v in local_candidates(candidate("rolling_friction", gripper), gripper)}
    many = Told(problem, {"left_tip": (0.06, 0.01), "right_tip": (0.05, 0.04), "thumb_tip": (-0.05, 0.9)})
    points = [(tips[e], np.log([0.0025])) for e in many.gains]
    fits = replay_means._compared(many, points)
    assert [f.labels for f in fits] == [("rolling_friction right_tip",), ("rolling_friction left_tip",)]
    assert fits[0].gain == pytest.approx(0.04, abs=1e-3)
    assert np.exp(fits[0].members[0][1][0]) == pytest.approx(0.003, rel=0.02), "where the parabola is least"


def test_where_nothing_gains_nothing_is_compared(null, gripper):
    problem, _ = null
    tips = [v for v in local_candidates(candidate("rolling_friction", gripper), gripper) if v.element == TIP]
    assert replay_means._compared(Told(problem, {TIP: (0.0, 0.5)}), [(tips[0], np.log([0.003]))]) == []
    assert replay_means._compared(Told(problem, {}), []) == []


def told(problem, gripper, label, losses):
    """Return a fit of an effect that leaves such losses."""
    name, _, element = label.partition(" ")
    c = candidate(name, gripper, element or None)
    loss = np.asarray(losses, float)
    return Fit(((c, c.neutral + 1.0),), None, CrossFit(1.1 - loss, loss, np.zeros((4, 1))))


@pytest.fixture(scope="module")
def replays(null):
    """Replays of the null problem that are played once for all tests."""
    problem, _ = null
    return Averaged(problem)


@pytest.mark.parametrize(
    ("more", "found"), [(0.05, True), (0.0, False), (-0.05, False)], ids=["surely", "as much", "less"]
)
def test_an_effect_moves_to_an_element_where_it_surely_gains_more(null, replays, gripper, monkeypatch, more, found):
    problem, _ = null
    monkeypatch.setattr(replay_means, "Averaged", lambda problem: replays)
    spread = 0.01 * np.random.default_rng(0).standard_normal(20)
    whole = told(problem, gripper, "torsional_friction", 1.05 + spread)
    tip = told(problem, gripper, "torsional_friction left_tip", 1.05 - more - spread)
    monkeypatch.setattr(replay_means, "_compared", lambda many, points: sorted((whole, tip), key=lambda f: -f.gain))
    shown = placed(problem, whole)
    assert (shown is not None) == found
    if shown:
        assert shown[0] is tip


def test_an_effect_of_a_group_is_compared_with_all_and_with_each_element(null, gripper, monkeypatch):
    problem, _ = null
    asked = []
    monkeypatch.setattr(replay_means, "_compared", lambda many, points: asked.extend(points) or [])
    assert placed(problem, told(problem, gripper, "torque_limit right", np.ones(20)))[0] is None, "nothing gains"
    labels = [c.label for c, _ in asked]
    assert {"torque_limit", "torque_limit right", "torque_limit right_base", "torque_limit left_base"} <= set(labels)
    assert all(labels.count(label) == labels.count("torque_limit") for label in labels), "each at as many values"


@pytest.mark.parametrize("label", ["object_inertia", "tactile_dead_band", "friction_cone", "joint_offset"])
def test_what_has_no_elements_or_needs_no_simulation_or_has_many_numbers_stays(null, gripper, monkeypatch, label):
    problem, _ = null
    monkeypatch.setattr(replay_means, "_compared", lambda *a: pytest.fail("compared"))
    assert placed(problem, told(problem, gripper, label, np.ones(20))) is None


@pytest.mark.parametrize(
    ("chosen", "remains", "base", "asked"),
    [
        (None, False, 1.3, "faint"),
        (None, True, 1.05, "faint"),
        (None, True, 1.3, None),
        ("torsional_friction", False, 1.06, "placed"),
        ("loud", False, 1.3, None),
    ],
)
def test_the_mean_is_asked_where_a_gap_is_faint(null, gripper, monkeypatch, chosen, remains, base, asked):
    problem, first = null
    first = replace(first, base=np.full(20, base))
    fit = (
        told(problem, gripper, "torsional_friction", np.full(20, 1.05 if chosen != "loud" else 0.7)) if chosen else None
    )
    better = told(problem, gripper, "torsional_friction left_tip", np.full(20, 1.0))
    called = []
    for name in ("faint", "placed"):
        monkeypatch.setattr(attribution, name, lambda *a, name=name: called.append(name) or (better, "many"))
    found = attribution._in_mean(
        problem, attribution.Attribution(first, fit, (fit,) if fit else (), problem.score, remains)
    )
    assert called == ([asked] if asked else [])
    if asked:
        assert (found.chosen.labels, found.mean, found.first.fits[0]) == (better.labels, "many", found.chosen)
        assert not found.remains
        assert found.chosen.gain == pytest.approx(better.gain)
        assert found.chosen.evidence.loss + found.chosen.evidence.gain == pytest.approx(first.base), "beside other fits"


@pytest.mark.parametrize(("other", "asked"), [(0.55, True), (0.75, False)], ids=["as much", "less"])
def test_the_mean_is_asked_of_what_other_elements_explain_as_well(null, gripper, monkeypatch, other, asked):
    problem, first = null
    spread = 0.1 * np.random.default_rng(0).standard_normal(20)
    whole = told(problem, gripper, "torsional_friction", 0.6 + spread)
    tip = told(problem, gripper, "torsional_friction left_tip", other - spread)
    assert whole.gain > attribution.UNPLACED
    called = []
    monkeypatch.setattr(attribution, "placed", lambda *a: called.append(a))
    found = attribution.Attribution(replace(first, fits=(whole, tip)), whole, (whole,), problem.score, False)
    assert attribution._in_mean(problem, found) is None
    assert bool(called) == asked


@pytest.mark.parametrize(("base", "stays"), [(1.06, False), (1.3, True)], ids=["faint", "a gap"])
def test_what_gains_nothing_in_the_mean_is_luck_where_nulls_have_as_much(null, gripper, monkeypatch, base, stays):
    problem, first = null
    whole = told(problem, gripper, "torsional_friction", np.full(20, 1.05))
    monkeypatch.setattr(attribution, "placed", lambda *a: (None, "many"))
    first = replace(first, base=np.full(20, base), fits=(whole,))
    shown = attribution._in_mean(problem, attribution.Attribution(first, whole, (whole,), problem.score, False))
    assert (shown is None) == stays
    if shown:
        assert (shown.chosen, shown.tied, shown.remains, shown.first) == (None, (), False, first)


def test_what_one_replay_shows_has_its_value_from_that(null, gripper, monkeypatch):
    problem, first = null
    labels = ("torsional_friction", "torsional_friction left_tip")
    whole, tip = (told(problem, gripper, label, np.full(20, 0.9)) for label in labels)
    sharp = told(problem, gripper, labels[1], np.full(20, 0.7))
    monkeypatch.setattr(attribution, "placed", lambda *a: (told(problem, gripper, labels[1], np.ones(20)), "many"))
    monkeypatch.setattr(
        attribution, "polished", lambda problem, fit, base: sharp if fit is tip else pytest.fail("other")
    )
    monkeypatch.setattr(attribution, "judged", lambda problem, fit: (fit, problem, True))
    found = attribution.Attribution(replace(first, fits=(whole, tip)), whole, (whole,), problem.score, False)
    shown = attribution._in_mean(problem, found)
    assert (shown.chosen, shown.tied, shown.mean, shown.remains) == (sharp, (sharp,), None, True)
    assert shown.first.fits == (sharp, whole)


@pytest.mark.parametrize(("force", "toss"), [(None, False), ("a pull", False), (None, True)])
def test_the_mean_is_not_asked_after_a_force_or_of_tosses(null, monkeypatch, force, toss):
    problem, first = null
    found = attribution.Attribution(first, None, (), problem.score, False, force=force)
    better = replace(found, mean="many")
    monkeypatch.setattr(attribution, "is_toss", lambda scene: toss)
    monkeypatch.setattr(attribution, "_attributed", lambda *a: found)
    monkeypatch.setattr(attribution, "_in_mean", lambda *a: better)
    assert (attribution.attribute(problem).mean == "many") == (force is None and not toss)


def test_the_report_says_that_it_shows_in_the_mean_alone(hidden, shown, gripper, played, planted, judge, monkeypatch):
    """The gap is that in the mean, and one of the notes says so."""
    (_, first), (in_mean, _) = hidden, shown

    def search(problem):
        found = attribution.Attribution(first, None, (), problem.score, False)
        return attribution._in_mean(problem, found)

    monkeypatch.setattr(attribution, "faint", lambda *a: in_mean)
    monkeypatch.setattr(diagnosis, "attribute", search)
    monkeypatch.setattr(diagnosis, "sizes_in_mean", lambda *a: (np.full(20, 1.05), np.full(20, 1.0)))
    effects = planted("rolling_friction", TIP, rolling_m=ROLLING_M)
    report = judge(gripper, played(gripper, effects, count=20, duration_s=2.4)).report
    assert [(e.name, e.element) for e in report.effects] == [("rolling_friction", TIP)]
    assert (report.gap.before, report.gap.after) == (1.05, 1.0)
    assert any("mean over 8 replays" in note for note in report.data.notes)


def test_a_dataset_without_a_faint_effect_keeps_its_notes(null, gripper, played, judge, monkeypatch):
    _, first = null
    monkeypatch.setattr(
        diagnosis, "attribute", lambda problem: attribution.Attribution(first, None, (), problem.score, False)
    )
    report = judge(gripper, played(gripper, count=20, duration_s=2.4)).report
    assert report.verdict == "no_gap"
    assert not any("mean over" in note for note in report.data.notes)
