"""Sets of causes: what was taken early can be exchanged, few true names replace many that make up for one another."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap import elsewhere, own_floor, sets, trials, worth
from candata.gap.candidates import candidate
from candata.gap.folds import cross_fit
from candata.gap.pace import Pace
from candata.gap.recordings import recordings
from candata.gap.refine import WIDTHS, around, divided, joint
from candata.gap.replay import Replayer
from candata.gap.screen import respond
from candata.gap.search import Fit, Problem, SoFar
from candata.gap.stage import look
from tests.gap.conftest import members, step_problem


def test_an_early_member_gives_way_to_the_true_one(arm, two_causes):
    problem, base = two_causes
    wrong = joint(problem, members(arm, joint_damping=0.3, actuation_delay=0.03), base)
    found = sets._swapped(problem, wrong)
    assert set(found.labels) == {"joint_dry_friction", "actuation_delay"}
    assert found.evidence.loss.mean() < wrong.evidence.loss.mean()


def test_what_a_blunt_fit_leaves_is_given_to_no_other_effect(arm, arm_episodes, planted):
    recs = recordings(arm, arm_episodes(planted("joint_dry_friction", frictionloss_Nm=0.3), count=12))
    problem = step_problem(arm, recs)
    base = problem.score.loss(problem.nominal)
    blunt = members(arm, joint_dry_friction=0.22)
    plane = around(problem, blunt, lambda u: divided(blunt, u))
    best = Fit(blunt, plane, cross_fit(replace(plane, slope=0 * plane.slope), problem.score, problem.parts, base))
    (found, _, _), _ = sets.forward(problem, best, [])
    assert found.labels == ("joint_dry_friction",)
    assert found.members[0][1] == pytest.approx(0.3, rel=0.02)


@pytest.mark.parametrize(("left", "again"), [(-0.05, True), (0.05, False)])
def test_a_set_that_seemed_to_leave_nothing_is_refitted_in_its_own_floors(monkeypatch, arm, left, again):
    """Its slopes were not simulated: blunt, it leaves what every further effect would seem to take."""

    names = ("object_com", "contact_compliance")
    both = tuple((SimpleNamespace(name=name), None) for name in names)

    def fit(loss):
        return SimpleNamespace(
            labels=names,
            members=both,
            evidence=SimpleNamespace(loss=np.full(12, 1 + loss)),
            gain=5.0 - loss,
            plane=SimpleNamespace(z=1 + loss),
        )

    sharp, in_its_own = fit(0.001), fit(0.3)
    score = SimpleNamespace(loss=lambda z: np.full(12, z))
    world = SimpleNamespace(score=score, nominal=6.0, measured=(), plays_all=False, recs=SimpleNamespace(tasks=()))
    world.pace, world.sofar, world.replayer = Pace(), SoFar(), Replayer(arm)
    looked: list[object] = []
    monkeypatch.setattr(sets, "rescored", lambda problem, best: (world, in_its_own))
    monkeypatch.setattr(sets, "leaves", lambda problem, best: best is in_its_own)
    monkeypatch.setattr(own_floor, "joint", lambda problem, members, base: sharp)
    monkeypatch.setattr(sets, "together", lambda *a: None)
    for name in ("_next", "_swapped", "moved", "shared", "paired", "_retraced"):
        monkeypatch.setattr(sets, name, lambda *a, name=name: looked.append(name))
    (found, _, remains), _ = sets.forward(world, fit(left), ())
    assert (found, remains, looked == []) == ((sharp, False, True) if again else (in_its_own, True, False))


def test_a_true_set_is_left_as_it_is(arm, two_causes):
    problem, base = two_causes
    right = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03), base)
    assert sets._swapped(problem, right) is None


def test_a_set_led_by_another_member_is_the_same_fit(arm, two_causes):
    problem, base = two_causes
    fit = joint(problem, members(arm, joint_dry_friction=0.25, actuation_delay=0.03), base)
    led = fit.led_by("actuation_delay")
    assert led.labels == ("actuation_delay", "joint_dry_friction")
    assert dict(zip(led.labels, (u for _, u in led.members), strict=True)) == dict(
        zip(fit.labels, (u for _, u in fit.members), strict=True)
    )
    point = np.array([0.35, 0.01])
    assert np.allclose(led.plane.read(point[::-1]), fit.plane.read(point), atol=1e-4)
    assert np.array_equal(led.evidence.points, fit.evidence.points[:, ::-1])


def test_the_next_best_and_a_third_replace_a_wrong_second(arm, arm_episodes, planted):
    effects = (
        *planted("joint_dry_friction", frictionloss_Nm=0.3),
        *planted("actuation_delay", delay_s=0.03),
        *planted("servo_gain", "shoulder", kp_scale=0.6),
    )
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = step_problem(arm, recs)
    base = problem.score.loss(problem.nominal)
    wrong = joint(problem, members(arm, joint_dry_friction=0.3, armature=0.01), base)
    found = sets._retraced(problem, wrong)
    assert set(found.labels) == {"joint_dry_friction", "actuation_delay", "servo_gain shoulder"}
    settled = replace(wrong, evidence=replace(wrong.evidence, loss=np.full(12, 1.4)))
    assert sets._retraced(problem, settled) is None
    assert sets._retraced(problem, replace(found, evidence=wrong.evidence)) is None  # no room for another


def test_two_join_a_set_together_if_each_gains_alone(arm, two_causes):
    problem, base = two_causes
    idle = joint(problem, members(arm, armature=0.0005), base)
    alone = [
        joint(problem, members(arm, **{name: value}), base)
        for name, value in (("actuation_delay", 0.03), ("joint_dry_friction", 0.3))
    ]
    sure = [replace(f, evidence=alone[0].evidence) for f in alone]
    assert {"joint_dry_friction", "actuation_delay"} < set(trials.paired(problem, idle, sure).labels)
    unsure = replace(sure[1], evidence=replace(sure[1].evidence, gain=sure[1].evidence.gain - sure[1].gain))
    assert trials.paired(problem, idle, [sure[0], unsure]) is None


def test_no_pair_joins_where_next_to_nothing_is_left(arm, two_causes):
    problem, base = two_causes
    right = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03), base)
    one = replace(right, members=right.members[:1])  # Room for two, and the loss of the true set.
    others = [joint(problem, members(arm, **{name: 0.01}), base) for name in ("joint_damping", "armature")]
    assert trials.paired(problem, one, [replace(f, evidence=right.evidence) for f in others]) is None


def test_a_fault_of_one_joint_is_taken_for_one_of_all_where_that_explains_more(arm, two_causes):
    problem, base = two_causes
    delay = members(arm, actuation_delay=0.03)
    elbow = (candidate("joint_dry_friction", arm, "elbow"), np.array([0.3]))
    wrong = joint(problem, (*delay, elbow), base)
    large = replace(wrong, evidence=replace(wrong.evidence, gain=100 * wrong.evidence.gain))
    for best in (wrong, large):  # a large gap, too, of which so little is left that it is worth no other name
        found = elsewhere.moved(problem, best)
        assert set(found.labels) == {"actuation_delay", "joint_dry_friction"}
    assert elsewhere.moved(problem, found) is None


def test_a_true_fault_of_one_joint_stays_one(arm, arm_episodes, planted):
    effects = (*planted("joint_damping", damping_Nms_rad=0.3), *planted("actuation_delay", "elbow", delay_s=0.03))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = step_problem(arm, recs)
    elbow = (candidate("actuation_delay", arm, "elbow"), np.array([0.03]))
    half = joint(problem, (elbow,), problem.score.loss(problem.nominal))
    assert float(half.evidence.loss.mean()) - 1 > worth.LEFT
    assert elsewhere.moved(problem, half) is None


def test_a_fault_moves_to_the_joint_that_has_it_and_what_made_up_for_it_goes(arm, arm_episodes, planted):
    recs = recordings(arm, arm_episodes(planted("actuation_delay", "shoulder", delay_s=0.03), count=12))
    problem = step_problem(arm, recs)
    elbow = (candidate("actuation_delay", arm, "elbow"), np.array([0.005]))
    wrong = joint(problem, (*members(arm, armature=0.0005), elbow), problem.score.loss(problem.nominal))
    assert elsewhere.moved(problem, wrong).labels == ("actuation_delay shoulder",)


def test_few_true_names_replace_many(arm, two_causes):
    problem, base = two_causes
    many = joint(
        problem,
        members(arm, joint_damping=0.01, joint_dry_friction=0.3, armature=0.0005, actuation_delay=0.03),
        base,
    )
    assert set(sets._rebuilt(problem, many, base).labels) == {"joint_dry_friction", "actuation_delay"}


def test_many_names_that_leave_most_of_it_open_are_not_taken(arm, two_causes, monkeypatch):
    problem, base = two_causes
    best = joint(problem, members(arm, armature=0.0005), base)
    better = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03), base)
    excess = float((base - 1).mean())
    for share, taken in ((0.4, False), (0.9, True)):
        evidence = replace(better.evidence, gain=better.evidence.gain * share * excess / better.gain)
        monkeypatch.setattr(sets, "sparse", lambda *a, e=evidence: replace(better, evidence=e))
        found, _, _ = sets.jointly(problem, best)
        assert (found is not best) is taken


def test_names_that_make_up_for_one_another_are_not_taken(arm, two_causes, monkeypatch):
    """Without one of them far more is wrong than in the nominal scene: its fit is undone by the others."""
    problem, base = two_causes
    best = joint(problem, members(arm, armature=0.0005), base)
    true = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03), base)
    assert not sets._cancels(problem, true)
    monkeypatch.setattr(sets, "sparse", lambda *a: true)
    assert sets.jointly(problem, best)[0] is not best
    far = [true.plane.z + 100 * np.sqrt(problem.nominal**2 + 1)] * 2
    monkeypatch.setattr(Problem, "without_each", lambda *a: far)
    assert sets._cancels(problem, true)
    assert sets.jointly(problem, best) == (best, problem, True)


@pytest.fixture
def small(arm, two_causes, monkeypatch):
    """Let a joint fit find so many names, which together gain so many floors beyond a full set: that set, then."""
    problem, base = two_causes
    best = joint(problem, members(arm, armature=0.0005), base)

    def finds(names: int, more: float):
        loss = best.evidence.loss - more
        found = replace(
            best, members=best.members * names, evidence=replace(best.evidence, loss=loss, gain=base - loss)
        )
        monkeypatch.setattr(sets, "sparse", lambda *a: found)
        monkeypatch.setattr(sets, "MOST", -np.inf)
        monkeypatch.setattr(sets, "is_full", lambda *a: True)
        return problem, replace(best, evidence=replace(best.evidence, gain=base))

    return finds


@pytest.mark.parametrize(("names", "remains"), [(4, False), (3, True)])
def test_where_many_names_explain_no_more_than_one_is_worth_many_little_things_remain(small, names, remains):
    problem, best = small(names, 0.01)
    found, _, left = sets.jointly(problem, best)
    assert found is best
    assert left is remains


@pytest.mark.parametrize(("names", "tried"), [(4, False), (3, True)])
def test_others_are_tried_in_the_place_of_each_of_three_only_where_no_many_are_found(small, names, tried, monkeypatch):
    problem, best = small(names, 0.01)
    asked = []
    monkeypatch.setattr(sets, "rescored", lambda world, fit: (world, fit))
    monkeypatch.setattr(sets, "has_room", lambda fit: True)
    monkeypatch.setattr(sets, "together", lambda *a: None)
    for name in ("_swapped", "moved", "shared", "paired", "_retraced"):
        monkeypatch.setattr(sets, name, lambda *a, name=name: asked.append(name))
    assert sets.forward(problem, best, ())[0][0] is best
    assert bool(asked) is tried


@pytest.mark.parametrize(("share", "tried"), [(0.9, ["moved"]), (1.1, ["moved", "shared", "paired", "_retraced"])])
def test_others_are_tried_in_place_of_early_members_only_where_a_tenth_of_the_gain_is_left(
    small, monkeypatch, share, tried
):
    """A fault of one element is taken for that of another however little is left."""
    problem, best = small(3, 0.01)
    best = replace(best, evidence=replace(best.evidence, gain=np.full(12, worth.left_by(best) / share / sets.RETRIED)))
    asked = []
    monkeypatch.setattr(sets, "rescored", lambda world, fit: (world, fit))
    monkeypatch.setattr(sets, "joins_first", lambda *a: False)
    monkeypatch.setattr(sets, "together", lambda *a: None)
    for name in ("_swapped", "moved", "shared", "paired", "_retraced"):
        monkeypatch.setattr(sets, name, lambda *a, name=name: asked.append(name))
    assert sets.forward(problem, best, ())[0][0] is best
    assert asked == tried


def test_slopes_rule_out_the_few_without_which_far_more_would_be_left(arm, two_causes, monkeypatch):
    problem, base = two_causes
    true = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03), base)
    some = (*true.members, *members(arm, armature=1e-4, joint_damping=1e-3))
    found, made = joint(problem, some, base, widths=()), []
    monkeypatch.setattr(sets, "joint", lambda problem, few, base: made.append(len(few)) or joint(problem, few, base))
    assert set(sets._rebuilt(problem, found, base).labels) == {"joint_dry_friction", "actuation_delay"}
    assert made == [2], "one alone is not fitted"


def test_choices_beside_effects_are_simulated_there(arm, two_causes, planted):
    problem, _ = two_causes
    held = members(arm, actuation_delay=0.03)
    here = problem.residuals([problem.setting(held)])[0]
    step = candidate("time_step", arm)
    ((_, curve),) = respond(replace(problem, library=None), here, [step], held)[0]
    u = next(u for u in curve.at if u != step.neutral[0])
    (beside,) = problem.residuals([problem.setting((*held, (step, np.array([u]))))])
    assert curve.read(np.array([u])) == pytest.approx(beside, abs=1e-5)


@pytest.mark.parametrize(
    ("promise", "unsure", "many", "tried", "sharply"),
    [
        (1.0, -np.inf, trials.MANY, True, 1),
        (0.8, np.inf, trials.MANY, True, 2),
        (0.8, np.inf, 1, True, 1),
        (0.5, np.inf, trials.MANY, False, 1),
    ],
)
def test_the_best_of_near_rivals_joins_the_set(arm, two_causes, monkeypatch, promise, unsure, many, tried, sharply):
    """What promises less beside what is held is tried too, sharply only what cannot be told from the best else."""
    problem, base = two_causes
    sharp: list[tuple[str, ...]] = []

    def counted(problem, chosen, base, widths=WIDTHS):
        sharp.extend([tuple(c.label for c, _ in chosen)] if len(widths) > 1 else [])
        return joint(problem, chosen, base, widths)

    monkeypatch.setattr(trials, "MANY", many)
    monkeypatch.setattr(trials, "UNSURE", unsure)
    monkeypatch.setattr(sets, "is_near", lambda fit, best: fit is best)
    monkeypatch.setattr(trials, "joint", counted)
    start = joint(problem, members(arm, actuation_delay=0.03), base)
    stage = look(problem, start.plane.z, start.members)
    true = next(f for f in stage.fits if f.labels == ("joint_dry_friction",))
    other = next(f for f in stage.fits if f.members[0][0].name != "joint_dry_friction")
    first, second = (replace(true.evidence, gain=share * true.evidence.gain) for share in (1.0, promise))
    swapped = replace(stage, fits=(replace(other, evidence=first), replace(true, evidence=second)))
    found = trials.sharp(problem, sets._front(start, swapped))
    assert (found.labels == ("actuation_delay", "joint_dry_friction")) is tried
    assert len(sharp) == sharply


@pytest.fixture(scope="module")
def alone(arm, two_causes):
    """Damping and friction, each fitted alone."""
    problem, base = two_causes
    return [joint(problem, members(arm, **{name: 0.3}), base) for name in ("joint_damping", "joint_dry_friction")]


def test_tied_causes_are_told_apart_beside_what_else_was_found(arm, two_causes, alone):
    """Under a delay of 30 ms friction and damping may look alike; with the delay in place they do not."""
    problem, base = two_causes
    chosen = joint(problem, members(arm, joint_damping=0.3, actuation_delay=0.03), base)
    tied, (best, _, _) = sets.compared(problem, chosen, alone, True)
    assert [f.labels for f in tied] == [("joint_dry_friction",)]
    assert set(best.labels) == {"joint_dry_friction", "actuation_delay"}
    assert float(best.evidence.loss.mean()) - 1 < worth.LEFT < float(chosen.evidence.loss.mean()) - 1


def test_a_first_cause_that_was_exchanged_is_tied_with_nothing(arm, two_causes, alone):
    problem, base = two_causes
    chosen = joint(problem, members(arm, joint_dry_friction=0.3, actuation_delay=0.03), base)
    tied, (best, _, _) = sets.compared(problem, chosen, alone, False)
    assert tied == alone[:1]
    assert best is chosen


@pytest.fixture(scope="module")
def lone(arm, two_causes):
    """A wrong first cause, of armature, and the true ones, each fitted alone; all three said to gain alike."""
    problem, base = two_causes
    values = {"armature": 0.0005, "joint_dry_friction": 0.3, "actuation_delay": 0.03}
    fits = [joint(problem, members(arm, **{name: value}), base) for name, value in values.items()]
    return [replace(f, evidence=fits[0].evidence) for f in fits]


@pytest.mark.parametrize(
    ("left", "extra", "spread", "tasks", "taken"),
    [
        (0.20, 0.15, 0.02, "", True),
        (0.20, 0.08, 0.02, "", False),  # leaves most of it
        (0.04, 0.039, 0.002, "", False),  # of next to nothing
        (0.20, 0.15, 0.20, "", False),  # not sure
        (0.20, 0.15, 0.20, "ab" * 6, True),  # sure, in one task of two
        (0.20, 0.15, 0.20, "aabb" * 3, False),
        (0.20, 0.15, 0.20, "ab" * 5 + "ac", False),  # of one episode of a task nothing is known
    ],
)
def test_a_small_effect_is_named_only_where_it_surely_takes_most_of_what_is_left(
    lone, left, extra, spread, tasks, taken
):
    best = replace(lone[0], evidence=replace(lone[0].evidence, loss=np.full(12, 1 + left), gain=np.full(12, 9.0)))
    gains = extra + spread * np.tile([-1.0, 1.0], 6)
    grown = replace(best, evidence=replace(best.evidence, loss=best.evidence.loss - gains))
    assert not worth.worth_adding(gains, best.gain)
    assert worth.settles(best, grown, tasks) is taken


@pytest.mark.parametrize(
    ("left", "extra", "spread", "taken"),
    [
        (0.5, 0.14, 0.02, True),
        (0.5, 0.10, 0.02, False),  # surely, but a fifth of what is left
        (0.5, 0.14, 0.60, False),  # not sure
        (10.0, 0.16, 0.02, True),  # 0.15 floors are worth a name whatever stays
        (10.0, 0.14, 0.02, False),
        (0.15, 0.02, 0.01, True),  # where little is left, a part of it may be contact's
        (0.15, 0.009, 0.001, False),  # not worth a name
    ],
)
def test_another_effect_is_named_that_takes_a_quarter_of_what_is_left(lone, left, extra, spread, taken):
    best = replace(lone[0], evidence=replace(lone[0].evidence, loss=np.full(12, 1 + left), gain=np.full(12, 0.2)))
    gains = extra + spread * np.tile([-1.0, 1.0], 6)
    grown = replace(best, evidence=replace(best.evidence, loss=best.evidence.loss - gains))
    assert worth.is_next(best, grown, ()) is taken


def test_what_takes_most_of_what_is_left_by_one_episode_is_not_named(lone):
    best = replace(lone[0], evidence=replace(lone[0].evidence, loss=np.full(12, 1.2), gain=np.full(12, 9.0)))
    gains = np.append(np.full(11, 0.03), 1.5)
    grown = replace(best, evidence=replace(best.evidence, loss=best.evidence.loss - gains))
    assert not worth.settles(best, grown, ())


def test_a_faint_effect_beside_a_strong_one_is_found(arm, arm_episodes, planted):
    effects = (*planted("actuation_delay", delay_s=0.02), *planted("joint_dry_friction", frictionloss_Nm=0.005))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = step_problem(arm, recs)
    delay = joint(problem, members(arm, actuation_delay=0.02), problem.score.loss(problem.nominal))
    (found, world, remains), _ = sets.forward(problem, delay, ())
    faint = float(world.score.loss(world.without_each(found.members)[-1]).mean() - found.evidence.loss.mean())
    assert found.labels == ("actuation_delay", "joint_dry_friction")
    assert faint < worth.EXTRA * found.gain
    assert not remains
