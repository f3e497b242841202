"""Sets with fewer effects that explain as much."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap import fewer, trials, worth
from candata.gap.candidates import candidate, local_candidates
from candata.gap.compare import is_tied
from candata.gap.diagnosis import _problem
from candata.gap.folds import cross_fit
from candata.gap.recordings import recordings
from candata.gap.refine import WIDTHS, around, divided, joint
from candata.gap.replay import Replayer
from candata.gap.search import Fit
from candata.gap.streams import Streams
from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.gap.conftest import members, plant


def blunt_fit(problem, some):
    """A set where it is, with its slopes, fitted by nothing."""
    plane = around(problem, some, lambda u: divided(some, u))
    base = problem.score.loss(problem.nominal)
    return Fit(some, plane, cross_fit(replace(plane, slope=0 * plane.slope), problem.score, problem.parts, base))


def test_a_member_goes_that_the_others_make_up_for(arm, two_causes):
    problem, _ = two_causes
    fit = blunt_fit(problem, members(arm, joint_dry_friction=0.2, actuation_delay=0.03, joint_damping=0.03))
    found, world, _ = fewer.simplified(problem, fit, True)
    assert found.labels == ("joint_dry_friction", "actuation_delay")
    assert world is not problem, "in units of the floor of its own world"
    assert found.members[0][1] == pytest.approx(0.3, rel=0.05)
    # Left out as they are, the others explain less than with it.
    losses = [problem.score.loss(z).mean() for z in (fit.plane.z, problem.without_each(fit.members)[2])]
    assert losses[1] > losses[0]


def test_a_member_worth_less_than_a_name_goes(arm, arm_episodes, planted):
    effects = (
        *planted("joint_dry_friction", frictionloss_Nm=0.3),
        *planted("actuation_delay", delay_s=0.03),
        *planted("armature", armature_kgm2=3e-5),
    )
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    some = members(arm, joint_dry_friction=0.3, actuation_delay=0.03, armature=3e-5)
    fit = joint(problem, some, problem.score.loss(problem.nominal))
    found, _, _ = fewer.simplified(problem, fit, True)
    assert found.labels == ("joint_dry_friction", "actuation_delay")
    cost = problem.score.loss(problem.without_each(fit.members)[2]).mean() - problem.score.loss(fit.plane.z).mean()
    assert worth.FAINT < cost < worth.EXTRA * fit.gain


def test_a_member_that_is_needed_or_was_measured_stays_and_nothing_is_fitted(arm, two_causes, monkeypatch):
    problem, base = two_causes
    right = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03), base)
    some = members(arm, joint_dry_friction=0.2, actuation_delay=0.03, joint_damping=0.03)
    for module in (fewer, trials):
        monkeypatch.setattr(module, "joint", lambda *a, **k: pytest.fail("it was fitted"))
    assert fewer.simplified(problem, right, True) == (right, problem, True)
    one = blunt_fit(problem, some[:1])
    assert fewer.simplified(problem, one, False) == (one, problem, False)
    known, fit = replace(problem, measured=(some[0], some[2])), blunt_fit(problem, some)
    assert fewer.simplified(known, fit, True)[0] is fit


@pytest.mark.parametrize(("true", "kept"), [((), False), (plant("time_step", time_step_s=0.005), True)])
def test_a_choice_goes_unless_the_others_do_not_make_up_for_it(arm, arm_episodes, planted, true, kept):
    effects = (*planted("joint_dry_friction", frictionloss_Nm=0.3), *planted("actuation_delay", delay_s=0.03), *true)
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    step = (candidate("time_step", arm), np.log([0.005 if true else 0.0025]))
    some = (*members(arm, joint_dry_friction=0.3, actuation_delay=0.03), step)
    fit = joint(problem, some, problem.score.loss(problem.nominal))
    found, _, _ = fewer.simplified(problem, fit, True)
    assert ("time_step" in found.labels) is kept
    assert {"joint_dry_friction", "actuation_delay"} <= set(found.labels)
    known = replace(problem, measured=(step,))
    assert "time_step" in fewer.simplified(known, fit, True)[0].labels


OFFSETS = [0.03, -0.05, 0.02, -0.03, 0.01, -0.02]


@pytest.mark.parametrize(
    ("true", "value", "kept"),
    [
        ("object_size", {"scale": 0.96}, ("object_size", "object_mass")),
        ("joint_offset", {"offset_rad": OFFSETS}, ("joint_offset", "object_mass")),
    ],
)
def test_many_numbers_go_that_take_a_part_of_one_more_effect_unless_they_are_true(planted, true, value, kept):
    """Slopes do not tell: where the numbers stand, without them most of the gap is open however the others move."""
    scene = load_scene("gripper_tabletop")
    effects = (*planted(true, **value), *planted("object_mass", mass_scale=1.5))
    jobs = [EpisodeJob(f"e{i:02d}", i, scene.policies[i % len(scene.policies)], 3, effects) for i in range(10)]
    recs = recordings(scene, make_episodes(scene, jobs, duration_s=1.6, noise=scene.file.noise))
    problem = _problem(Replayer(scene), recs, Streams(0), None, lambda stage: None)
    mass, size = members(scene, object_mass=0.4, object_size=-0.02)
    stand_in = (candidate("joint_offset", scene), np.array([0.02, -0.03, 0.015, -0.03, 0.0, 0.0]))
    offsets = (stand_in[0], np.array(OFFSETS))
    begun = (stand_in, size, mass) if true == "object_size" else (offsets, mass)
    fit = joint(problem, begun, problem.score.loss(problem.nominal))
    assert "joint_offset" not in [c.name for c, _ in fewer._spare(problem, fit, fit.members)]
    found, _, _ = fewer.simplified(problem, fit, True)
    assert found.labels == kept
    if true == "object_size":
        assert np.exp(found.members[0][1]) == pytest.approx(0.96, abs=0.003)


def test_what_else_can_be_left_out_goes_after_many_numbers(monkeypatch):
    """Beside two right names, six joint offsets hid that an object's size and a support's height were worth nothing."""
    many, lighter, fewest = (SimpleNamespace(members=tuple(range(count))) for count in (5, 4, 2))
    monkeypatch.setattr(fewer, "_free", lambda problem, best: ())
    monkeypatch.setattr(fewer, "_spare", lambda problem, best, free: ())
    monkeypatch.setattr(fewer, "_without_one", lambda problem, best, free: lighter if best is many else None)
    monkeypatch.setattr(fewer, "_without_some", lambda problem, best, spare: fewest if best is lighter else None)
    monkeypatch.setattr(fewer, "judged", lambda problem, fit: (fit, problem, False))
    assert fewer.simplified("problem", many, True) == (fewest, "problem", False)


def on(arm, name, element):
    """An effect on one element, as a candidate."""
    return next(c for c in local_candidates(candidate(name, arm), arm) if c.element == element)


def test_what_either_of_two_joints_does_as_well_is_said_of_all(arm, two_causes):
    problem, base = two_causes
    local = (on(arm, "joint_dry_friction", "shoulder"), np.full(1, 0.3))
    fit = joint(problem, (local, *members(arm, actuation_delay=0.03)), base)
    found, world, _ = fewer.widened(problem, fit, True)
    assert found.labels == ("joint_dry_friction", "actuation_delay")
    assert found.members[0][1] == pytest.approx(0.3, rel=0.05)
    assert found.gain > fit.gain
    assert world is not problem, "in units of the floor of its own world"


@pytest.mark.parametrize(
    ("light", "all_over", "whole"),
    [
        (0.5, 0.5, True),
        (-0.002, 0.02, True),
        (-0.002, -0.001, False),
        (-0.5, 0.5, False),
    ],
)
def test_of_all_and_one_element_beside_others_the_one_that_explains_more_is_named(
    arm, two_causes, monkeypatch, light, all_over, whole
):
    """Where no other element would do as well; sharply fitted only what a light fit cannot tell from the best."""
    problem, base = two_causes
    local = (on(arm, "joint_dry_friction", "shoulder"), np.full(1, 0.3))
    fit = joint(problem, (local, *members(arm, actuation_delay=0.03)), base)

    def fitted(problem, some, base, widths=WIDTHS):
        gained = all_over if widths else light
        loss = fit.evidence.loss - (gained if some[0][0].element is None else -9.0)
        return replace(fit, members=some, evidence=replace(fit.evidence, loss=loss, gain=base - loss))

    monkeypatch.setattr(fewer, "joint", fitted)
    found, _, _ = fewer.widened(problem, fit, True)
    assert found.labels == ("joint_dry_friction" if whole else local[0].label, "actuation_delay")


def test_the_fault_of_one_joint_stays_its_own(arm, arm_episodes, planted):
    effects = (
        *planted("joint_dry_friction", "elbow", frictionloss_Nm=0.3),
        *planted("actuation_delay", delay_s=0.03),
    )
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    local = (on(arm, "joint_dry_friction", "elbow"), np.full(1, 0.3))
    fit = joint(problem, (local, *members(arm, actuation_delay=0.03)), problem.score.loss(problem.nominal))
    assert fewer.widened(problem, fit, False) == (fit, problem, False)
    alone = blunt_fit(problem, fit.members[:1])
    assert fewer.widened(problem, alone, False) == (alone, problem, False), "single causes are compared elsewhere"


def test_all_numbers_of_a_vector_take_the_place_of_one_s_and_of_what_makes_up_for_the_rest(arm, arm_episodes, planted):
    offsets = (0.05, -0.04)
    recs = recordings(arm, arm_episodes(planted("joint_offset", offset_rad=offsets), count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    part = (on(arm, "joint_offset", "shoulder"), np.full(1, 0.04))
    some = (part, *members(arm, servo_gain=0.8, joint_dry_friction=0.02))
    fit = joint(problem, some, problem.score.loss(problem.nominal))
    found, world, _ = fewer.completed(problem, fit, False)
    assert found.labels == ("joint_offset",)
    # A shoulder on a plumb axis shows nothing of its own offset.
    assert found.members[0][1][1] == pytest.approx(offsets[1], rel=0.05)
    assert found.gain > fit.gain
    assert world is not problem, "in units of the floor of its own world"


@pytest.mark.parametrize("offsets", [(0.05, -0.04), (0.05, 0.0)], ids=["two joints", "one that shows nothing"])
def test_all_numbers_of_a_vector_take_the_place_of_one_s_beside_what_is_true(arm, arm_episodes, planted, offsets):
    true = (*planted("joint_offset", offset_rad=offsets), *planted("joint_dry_friction", frictionloss_Nm=0.3))
    recs = recordings(arm, arm_episodes(true, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    some = ((on(arm, "joint_offset", "shoulder"), np.full(1, 0.04)), *members(arm, joint_dry_friction=0.3))
    fit = joint(problem, some, problem.score.loss(problem.nominal))
    found, _, _ = fewer.completed(problem, fit, True)
    if offsets[1]:
        assert set(found.labels) == {"joint_offset", "joint_dry_friction"}
        assert found.members[0][1][1] == pytest.approx(offsets[1], rel=0.05)
    else:
        assert found is fit


def test_the_numbers_of_one_element_stay_alone_where_no_other_is_off(arm, arm_episodes, planted):
    effects = (
        *planted("joint_offset", "elbow", offset_rad=0.05),
        *planted("joint_dry_friction", frictionloss_Nm=0.3),
    )
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    part = (on(arm, "joint_offset", "elbow"), np.full(1, 0.05))
    fit = joint(problem, (part, *members(arm, joint_dry_friction=0.3)), problem.score.loss(problem.nominal))
    assert fewer.completed(problem, fit, False) == (fit, problem, False)
    alone = blunt_fit(problem, fit.members[:1])
    assert fewer.completed(problem, alone, False) == (alone, problem, False), "single causes are compared elsewhere"


def test_one_effect_takes_the_place_of_two_that_stand_for_it(arm, two_causes, monkeypatch):
    problem, base = two_causes
    wrong = joint(problem, members(arm, joint_dry_friction=0.3, servo_damping=0.3, armature=0.0005), base)
    found, world, _ = fewer.merged(problem, wrong, True)
    assert set(found.labels) == {"joint_dry_friction", "actuation_delay"}
    assert found.gain > wrong.gain
    assert world is not problem, "in units of the floor of its own world"
    monkeypatch.setattr(fewer, "is_next", lambda fewer, whole, tasks: True)
    assert fewer.merged(problem, wrong, True)[0] is wrong, "not where that costs what is worth a name"


def test_what_stands_in_place_of_two_is_looked_for_with_the_others_moved_along(arm, two_causes):
    problem, _ = two_causes
    some = members(arm, actuation_delay=0.026, joint_damping=0.01, armature=1e-4)
    first, *rivals = fewer._instead(problem, np.arange(12), blunt_fit(problem, some), some[1:])
    assert [c.label for c, _ in first] == ["actuation_delay", "joint_dry_friction"]
    assert first[0][1] == pytest.approx([0.03], abs=0.001)
    assert len(rivals) == 2


def test_two_effects_stay_where_no_one_explains_as_much_or_nothing_remains(arm, arm_episodes, planted, monkeypatch):
    effects = (
        *planted("joint_dry_friction", frictionloss_Nm=0.3),
        *planted("actuation_delay", delay_s=0.03),
        *planted("servo_gain", "shoulder", kp_scale=0.6),
    )
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    weak = (candidate("servo_gain", arm, "shoulder"), np.log([0.6]))
    some = (*members(arm, joint_dry_friction=0.3, actuation_delay=0.03), weak)
    right = joint(problem, some, problem.score.loss(problem.nominal))
    monkeypatch.setattr(fewer, "OPEN", -np.inf)
    assert fewer.merged(problem, right, True) == (right, problem, True)
    for module in (fewer, trials):
        monkeypatch.setattr(module, "joint", lambda *a, **k: pytest.fail("it was fitted"))
    assert fewer.merged(problem, right, False) == (right, problem, False)
    assert fewer.merged(replace(problem, measured=some[:2]), right, True)[0] is right
    assert fewer.merged(replace(problem, simulated=True), right, True)[0] is right
    monkeypatch.undo()
    little = replace(right, evidence=replace(right.evidence, loss=np.full(12, 1 + 0.99 * fewer.OPEN)))
    assert fewer.merged(problem, little, True) == (little, problem, True)


def test_one_in_place_of_two_that_makes_up_for_little_is_not_fitted_on_all(arm, two_causes, monkeypatch):
    problem, base = two_causes
    wrong = joint(problem, members(arm, joint_dry_friction=0.3, servo_damping=0.3, armature=0.0005), base)
    real, tried = fewer.lightly_fitted, []

    def little(part, members):
        tried.append(members)
        return float(part.score.loss(part.nominal).mean()), members

    monkeypatch.setattr(fewer, "lightly_fitted", little)
    monkeypatch.setattr(fewer, "joint", lambda *a, **k: pytest.fail("it was fitted on all"))
    assert fewer.merged(problem, wrong, True) == (wrong, problem, True)
    assert tried
    monkeypatch.setattr(fewer, "lightly_fitted", real)
    with pytest.raises(pytest.fail.Exception):
        fewer.merged(problem, wrong, True)


@pytest.mark.parametrize("true", [plant("time_step", time_step_s=0.005), plant("armature", armature_kgm2=0.002)])
def test_a_choice_takes_the_place_of_many_that_stand_for_it(arm, arm_episodes, planted, true):
    recs = recordings(arm, arm_episodes((*true, *planted("joint_dry_friction", frictionloss_Nm=0.3)), count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    many = {"joint_dry_friction": 0.3, "joint_damping": 0.06, "actuation_delay": 0.005, "armature": 0.002}
    wrong = joint(problem, members(arm, **many), problem.score.loss(problem.nominal))
    found, world, _ = fewer.by_choice(problem, wrong, True)
    if true[0].name == "time_step":
        assert found.labels == ("joint_dry_friction", "time_step"), "what is idle beside it goes, too"
        assert found.gain > wrong.gain
        assert world is not problem, "in units of the floor of its own world"
    else:
        assert found is wrong


def test_no_choice_is_tried_in_place_of_few(arm, two_causes, monkeypatch):
    problem, _ = two_causes
    some = members(arm, joint_dry_friction=0.3, actuation_delay=0.03, joint_damping=0.03, armature=3e-5)
    monkeypatch.setattr(fewer, "lightly", lambda *a: pytest.fail("it was tried"))
    few = blunt_fit(problem, some[:3])
    assert fewer.by_choice(problem, few, True) == (few, problem, True)
    with pytest.raises(pytest.fail.Exception):
        fewer.by_choice(problem, blunt_fit(problem, some), True)


def test_of_a_fit_of_many_all_that_is_spare_goes_at_once(arm, two_causes, monkeypatch):
    problem, _ = two_causes
    named = members(arm, joint_dry_friction=0.3, actuation_delay=0.03)
    others = members(arm, joint_damping=0.01, armature=1e-4, servo_damping=0.01)
    fit = blunt_fit(problem, (*named, *others))
    made = []

    def counted(problem, some, base, widths=WIDTHS):
        made.append(([c.name for c, _ in some], widths))
        return joint(problem, some, base, widths)

    monkeypatch.setattr(fewer, "joint", counted)
    monkeypatch.setattr(fewer, "_spare", lambda problem, best, free: others if best is fit else ())
    found, _, _ = fewer.simplified(problem, fit, True)
    assert found.labels == ("joint_dry_friction", "actuation_delay")
    few = ["joint_dry_friction", "actuation_delay"]
    assert made == [(few, ()), (few, WIDTHS[1:])]


def test_a_fit_of_many_is_thinned_again_and_again_before_it_is_sharpened(arm, two_causes, monkeypatch):
    problem, _ = two_causes
    named = members(arm, joint_dry_friction=0.3, actuation_delay=0.03)
    others = members(arm, joint_damping=0.01, armature=1e-4, servo_damping=0.01)
    made = []

    def counted(problem, some, base, widths=WIDTHS):
        made.append((len(some), widths))
        return joint(problem, some, base, widths)

    def first_spare(problem, best, free):
        return tuple(m for m in best.members if m[0].name in {c.name for c, _ in others})[:1]

    monkeypatch.setattr(fewer, "joint", counted)
    monkeypatch.setattr(fewer, "_spare", first_spare)
    fit = blunt_fit(problem, (*named, *others))
    found = fewer._without_some(problem, fit, first_spare(problem, fit, ()))
    assert made == [(4, ()), (3, ()), (3, WIDTHS[1:])]
    assert {"joint_dry_friction", "actuation_delay"} <= set(found.labels)


def test_a_fit_of_many_does_not_lose_step_by_step_what_it_explains(monkeypatch):
    """Of seven names each is worth less than fits are sharp: one may go, not one after another."""

    def of(count):
        members = tuple((SimpleNamespace(name=f"effect {i}"), None) for i in range(count))
        loss = np.full(12, 1.6 + 0.015 * (7 - count))
        return SimpleNamespace(members=members, evidence=SimpleNamespace(loss=loss), gain=4.0 - float(loss.mean()))

    monkeypatch.setattr(fewer, "joint", lambda problem, members, base, widths=None: of(len(members)))
    monkeypatch.setattr(fewer, "_spare", lambda problem, best, free: best.members[:1])
    monkeypatch.setattr(fewer, "_free", lambda problem, best: best.members)
    whole = of(7)
    assert is_tied(of(6), whole)
    assert not is_tied(of(5), whole)
    assert len(fewer._thinned(None, whole, whole, whole.members[:1], np.ones(12)).members) == 6


@pytest.mark.parametrize(("left", "times"), [(4, 1), (3, 2)])
def test_a_fit_that_is_still_of_many_is_thinned_once(monkeypatch, left, times):
    made = []

    def fewer_of(problem, best, spare):
        made.append(best)
        return SimpleNamespace(members=(None,) * left) if len(made) == 1 else None

    monkeypatch.setattr(fewer, "_without_some", fewer_of)
    monkeypatch.setattr(fewer, "_spare", lambda problem, best, free: ())
    monkeypatch.setattr(fewer, "_free", lambda problem, best: ())
    monkeypatch.setattr(fewer, "judged", lambda problem, fit: (fit, "its world", True))
    found, world, remains = fewer.simplified("a world", SimpleNamespace(members=(None,) * 6), True)
    assert (len(found.members), world, remains, len(made)) == (left, "its world", True, times)


def test_of_a_fit_of_many_what_is_needed_stays_though_it_seemed_spare(arm, two_causes, monkeypatch):
    problem, _ = two_causes
    some = members(arm, joint_dry_friction=0.3, joint_damping=0.01, armature=1e-4, actuation_delay=0.03)
    fit = blunt_fit(problem, some)
    monkeypatch.setattr(fewer, "_spare", lambda problem, best, free: tuple(free[1:]))
    found, _, _ = fewer.simplified(problem, fit, True)
    assert {"joint_dry_friction", "actuation_delay"} <= set(found.labels)
