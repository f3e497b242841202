"""Near rivals: looked at on every element, by typical losses, and told apart only where the data can."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from candata.effects import flatten
from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate
from candata.gap.fit.comparison import tied_with
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import CrossFit
from candata.gap.fit.response import Curve, Plane
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening import look as staging
from candata.gap.screening.look import narrowed, sharpened, typical
from candata.gap.screening.signature_screen import respond
from candata.scenes import load_scene

BASE = np.full(8, 2.0)
CHANNELS = ("joint_position", "object_pose", "fingertip_force")


def fit(c, loss: np.ndarray) -> Fit:
    return Fit(((c, np.ones(1)),), None, CrossFit(BASE - loss, loss, np.zeros((4, 1))))


@pytest.fixture(scope="module")
def posed(arm, arm_episodes, planted):
    """The function that gives the problem that an arm with a fault poses."""

    def pose(*fault, **parameters):
        recs = recordings(arm, arm_episodes(planted(*fault, **parameters)))
        return _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)

    return pose


@pytest.mark.parametrize(
    ("name", "element", "parameters", "wrong"),
    [
        ("joint_dry_friction", "elbow", {"frictionloss_Nm": 0.4}, ("joint_dry_friction", "shoulder")),
        ("servo_gain", "shoulder", {"kp_scale": 0.6}, ("joint_damping", "shoulder")),
    ],
)
def test_a_fault_of_one_element_brings_its_neighbours_and_other_effects_there(
    arm, posed, name, element, parameters, wrong
):
    problem = posed(name, element, **parameters)
    base, luck = typical(problem)
    ((c, curve),) = respond(problem, problem.nominal, [candidate(wrong[0], arm, wrong[1])])[0]
    first = staging.fit_one(problem, c, curve, base)
    found = narrowed(problem, problem.nominal, staging.Stage(base, luck, (first,), 0.0, (), (), (), 0.0))
    assert found.fits[0].labels == (f"{name} {element}",)


@pytest.mark.parametrize(
    ("truth", "found"),
    [
        ({"thumb_bend": 0.05, "thumb_rota1": -0.04, "thumb_rota2": 0.06}, "joint_offset thumb"),
        ({"ring1": 0.05}, "joint_offset ring1"),
        ({"thumb_bend": 0.05, "mid1": -0.05, "ring2": 0.05, "pinky1": 0.05}, None),
    ],
)
def test_the_numbers_of_one_finger_stand_for_a_vector_where_they_keep_what_it_gains(hand, monkeypatch, truth, found):
    """Residuals are the offsets that are still missing, off by a little where the vector was fitted."""
    whole = candidate("joint_offset", hand)
    names = [hand.file.joints[i] for i in hand.driven_hinges]
    true = np.array([truth.get(name, 0.0) for name in names])
    luck = np.random.default_rng(0).normal(0, 0.002, (8, len(true)))

    def residuals(worlds):
        return [((true - flatten(world[0], hand) + luck) / 0.01).astype(np.float32) for world in worlds]

    score = SimpleNamespace(loss=lambda z: 1 + (z**2).mean(1))
    problem = SimpleNamespace(
        replayer=SimpleNamespace(scene=hand),
        residuals=residuals,
        score=score,
        setting=lambda members: [c.setting(u, hand) for c, u in members],
    )
    monkeypatch.setattr(staging, "brief", lambda problem: (problem, np.arange(8)))
    monkeypatch.setattr(staging, "_fits", lambda problem, planes, base: planes)
    at = true + np.linspace(-0.004, 0.004, len(true))
    plane = Plane(whole.low, whole.high, at, luck, -100 * np.repeat(np.eye(len(true))[:, None], 8, axis=1))
    base = score.loss(residuals([[whole.setting(0 * at, hand)]])[0])
    first = staging.Stage(base, luck, (Fit(((whole, at),), plane, None),), 0.0, (), (), (), 0.0)
    parts = staging._parts(problem, first.fits[0], first)
    assert [v.label for v, _ in parts[:1]] == ([found] if found else [])
    for v, own in parts:
        assert np.array_equal(own.at, at[v.own])
        assert own.slope.shape == (v.size, 8, len(true))


def test_a_scalar_has_no_numbers_of_one_element(arm, posed):
    best = fit(candidate("joint_damping", arm), BASE / 2)
    assert staging._parts(None, best, None) == []


def test_beside_an_effect_on_slides_the_same_one_is_tried_on_hinges(hand):
    problem = SimpleNamespace(
        replayer=SimpleNamespace(scene=hand), recs=SimpleNamespace(channels=CHANNELS), ruled_out=frozenset()
    )
    held = ((candidate("actuation_delay", hand, "wrist"), np.array([0.03])),)
    assert [c.label for c in staging.unheld(problem, held) if c.name == "actuation_delay"] == ["actuation_delay"]
    held = ((candidate("actuation_delay", hand, "index"), np.array([0.03])),)
    assert not [c for c in staging.unheld(problem, held) if c.name == "actuation_delay"]


def test_beside_an_effect_the_same_one_is_tried_on_slides_only(hand):
    problem = SimpleNamespace(
        replayer=SimpleNamespace(scene=hand), recs=SimpleNamespace(channels=CHANNELS), ruled_out=frozenset()
    )
    held = ((candidate("actuation_delay", hand), np.array([0.03])), (candidate("joint_damping", hand), np.ones(1)))
    again = [c.label for c in staging.unheld(problem, held) if c.name in ("actuation_delay", "joint_damping")]
    assert again == ["actuation_delay wrist"]
    more = (*held, (candidate("actuation_delay", hand, "wrist"), np.array([0.03])))
    assert not [c for c in staging.unheld(problem, more) if c.name == "actuation_delay"]


def test_rivals_are_compared_by_their_typical_losses(arm, monkeypatch):
    """One replay dealt the second rival all the luck; from other starts it is the worse one."""
    steady, lucky = candidate("joint_damping", arm), candidate("servo_damping", arm)
    losses = {"joint_damping": [1.0, 1.0, 1.0, 1.0], "servo_damping": [0.9, 1.4, 1.4, 1.4]}

    def losses_from(begins, worlds):
        return np.array([[np.full(8, losses[world][begin]) for world in worlds] for begin in begins])

    problem = SimpleNamespace(
        begin=0,
        losses_from=losses_from,
        setting=lambda members: members[0][0].name,
        replayer=SimpleNamespace(scene=arm),
    )
    monkeypatch.setattr(staging, "_starts", lambda *asked: [1, 2, 3])
    monkeypatch.setattr(staging, "polished", lambda problem, best, base: best)
    fits = (fit(lucky, BASE * 0.45), fit(steady, BASE * 0.5))
    first = staging.Stage(BASE, np.zeros((4, len(BASE))), fits, 0.0, (), (), (), 0.0)
    found = sharpened(problem, first)
    assert [f.labels[0] for f in found.fits] == ["joint_damping", "servo_damping"]
    assert found.fits[0].gain == pytest.approx(1.0)
    assert found.fits[1].gain == pytest.approx(2.0 - 1.4)


def sharply(arm, monkeypatch, sharp: dict[str, float]) -> SimpleNamespace:
    """Return a problem in which each effect leaves this loss where it is sharp, from whatever start."""
    problem = SimpleNamespace(
        begin=0,
        replayer=SimpleNamespace(scene=arm),
        setting=lambda members: members[0][0].name,
        losses_from=lambda begins, worlds: np.array([[np.full(8, sharp[w]) for w in worlds] for _ in begins]),
    )
    monkeypatch.setattr(staging, "_starts", lambda *asked: [1, 2, 3])
    monkeypatch.setattr(
        staging, "polished", lambda problem, f, base: fit(f.members[0][0], np.full(8, sharp[f.labels[0]]))
    )
    return problem


@pytest.mark.parametrize(("threshold", "first"), [(0.0, "joint_damping"), (0.05, "servo_damping")])
def test_a_rival_of_a_faint_effect_is_sharpened_where_nulls_gain_as_much(arm, monkeypatch, threshold, first):
    """Sharp, it is the better one; it is not looked at where nulls gain nothing to speak of."""
    sharp = {"joint_damping": 1.95, "servo_damping": 1.94}
    problem = sharply(arm, monkeypatch, sharp)
    fits = (fit(candidate("joint_damping", arm), np.full(8, 1.95)), fit(candidate("servo_damping", arm), BASE - 0.02))
    stage = staging.Stage(BASE, np.zeros((4, len(BASE))), fits, threshold, (), (), (), 0.0)
    assert sharpened(problem, stage).fits[0].labels == (first,)


@pytest.mark.parametrize(("other", "first"), [("elbow", "elbow"), (None, "shoulder")])
def test_the_next_joints_fault_is_sharpened_too_but_not_that_of_all(arm, monkeypatch, other, first):
    """Sharp, it is the better one; of all joints the same fault is no rival of one's."""
    alone, better = candidate("joint_damping", arm, "shoulder"), candidate("joint_damping", arm, other)
    sharp = {alone.label: np.full(8, 1.1), better.label: np.full(8, 1.0)}
    problem = SimpleNamespace(
        begin=0,
        replayer=SimpleNamespace(scene=arm),
        setting=lambda members: members[0][0].label,
        losses_from=lambda begins, worlds: np.array([[sharp[w] for w in worlds] for _ in begins]),
    )
    polished = []

    def polish(problem, f, base):
        polished.append(f.labels[0])
        return fit(f.members[0][0], sharp[f.labels[0]])

    monkeypatch.setattr(staging, "_starts", lambda *asked: [1, 2, 3])
    monkeypatch.setattr(staging, "polished", polish)
    fits = (fit(alone, np.full(8, 1.1)), fit(better, np.full(8, 1.12)))
    found = sharpened(problem, staging.Stage(BASE, np.zeros((4, len(BASE))), fits, 0.0, (), (), (), 0.0))
    assert found.fits[0].labels == (f"joint_damping {first}",)
    assert len(polished) == (2 if other else 1)


@pytest.mark.parametrize(
    ("leaves", "sharp", "first"), [(0.06, -0.02, "right"), (0.06, 0.055, "right_base"), (0.01, -0.02, "right_base")]
)
def test_all_of_a_finger_s_numbers_are_sharpened_where_those_of_one_joint_leave_something(
    monkeypatch, leaves, sharp, first
):
    """Named are more numbers only if they surely explain more."""
    scene = load_scene("gripper_tabletop")
    one, both = (candidate("joint_offset", scene, name) for name in ("right_base", "right"))
    losses = {one.label: np.full(8, 1 + leaves), both.label: np.full(8, 1 + sharp)}
    problem = SimpleNamespace(
        begin=0,
        replayer=SimpleNamespace(scene=scene),
        setting=lambda members: members[0][0].label,
        losses_from=lambda begins, worlds: np.array([[losses[w] for w in worlds] for _ in begins]),
    )
    monkeypatch.setattr(staging, "_starts", lambda *asked: [1, 2, 3])
    monkeypatch.setattr(staging, "polished", lambda problem, f, base: fit(f.members[0][0], losses[f.labels[0]]))
    monkeypatch.setattr(staging, "joint", lambda problem, members, base: fit(one, losses[one.label]))
    fits = (fit(one, np.full(8, 1 + leaves)), fit(both, np.full(8, 1.13)))
    found = sharpened(problem, staging.Stage(BASE, np.zeros((4, len(BASE))), fits, 0.0, (), (), (), 0.0))
    assert found.fits[0].labels == (f"joint_offset {first}",)


@pytest.mark.parametrize(("other", "slopes"), [("pose_bias", True), ("pose_latency", False)])
def test_a_scalar_is_fitted_as_a_vector_that_it_is_compared_with(hand, monkeypatch, other, slopes):
    """By slopes it is the better one; beside another scalar both are read off curves, and none is taken."""
    losses = {"pose_scale": 0.98 if slopes else 1.04, other: 1.0}
    problem = SimpleNamespace(
        begin=0,
        replayer=SimpleNamespace(scene=hand),
        setting=lambda members: members[0][0].name,
        losses_from=lambda begins, worlds: np.array([[np.full(8, losses[w]) for w in worlds] for _ in begins]),
    )
    monkeypatch.setattr(staging, "_starts", lambda *asked: [1, 2, 3])
    monkeypatch.setattr(staging, "polished", lambda problem, best, base: best)
    monkeypatch.setattr(staging, "joint", lambda problem, members, base: fit(members[0][0], np.full(8, 0.98)))
    fits = (fit(candidate(other, hand), np.full(8, 1.0)), fit(candidate("pose_scale", hand), np.full(8, 1.04)))
    found = sharpened(problem, staging.Stage(BASE, np.zeros((4, len(BASE))), fits, 0.0, (), (), (), 0.0))
    assert found.fits[0].labels == ("pose_scale" if slopes else other,)
    assert found.fits[0].gain == pytest.approx(1.02 if slopes else 1.0)


def test_a_rival_that_gains_less_is_near_while_episodes_do_not_tell_the_two_apart(arm):
    best = fit(candidate("joint_damping", arm), np.full(8, 1.0))
    c, swing = candidate("servo_damping", arm), np.tile([1.0, -1.0], 4)
    # It gains 30 % less; the standard error of that is 0.38 where episodes disagree, 0.01 where they agree.
    unsure, surely = fit(c, 1.3 + swing), fit(c, 1.3 + 0.03 * swing)
    assert staging.is_near(unsure, best)
    assert not staging.is_near(surely, best)
    assert staging.is_near(fit(c, np.full(8, 1.1)), best)


def test_a_gain_that_is_larger_by_less_than_fits_are_sharp_decides_nothing(arm):
    best, alias, other = (
        fit(candidate(name, arm), np.full(8, loss))
        for name, loss in [("servo_damping", 1.0), ("joint_damping", 1.006), ("armature", 1.02)]
    )
    assert best.gain == pytest.approx(1.0)
    assert tied_with(best, [best, alias, other]) == [best, alias]


def test_of_what_lies_below_the_loss_of_true_worlds_nine_chances_in_ten_are_asked(arm):
    """The rival leaves 1.15 standard errors more."""
    more = 0.1 + 0.23 * np.array([-1, 1] * 4)
    losses = [("armature", np.full(8, 0.8)), ("time_step", 0.8 + more)]
    best, rival = (fit(candidate(name, arm), loss) for name, loss in losses)
    assert tied_with(best, [best, rival]) == [best]
    assert tied_with(best, [best, rival], reachable=0.95) == [best, rival]
    assert tied_with(best, [best, rival], reachable=0.85) == [best]
    clear = fit(candidate("time_step", arm), 0.8 + more + 0.05)
    assert tied_with(best, [best, clear], reachable=1.0) == [best]


@pytest.mark.parametrize(
    ("everywhere", "one", "found"),
    [
        (0.92, 0.95, None),  # more for all joints, within a standard error: all
        (0.95, 0.92, None),  # less for all joints, within a standard error: the elbow's may be chance
        (1.05, 0.92, "elbow"),
        (0.92, 0.925, "elbow"),  # alike as far as fits are sharp: the one joint
    ],
)
def test_of_all_and_one_element_the_one_that_surely_gains_more_is_named(arm, everywhere, one, found):
    spread = np.linspace(-0.1, 0.1, 8)
    fits = [
        fit(candidate("joint_damping", arm), everywhere + spread),
        fit(candidate("joint_damping", arm, "elbow"), one - spread),
    ]
    best = max(fits, key=lambda f: f.gain)
    assert all(staging.is_tied(f, best) for f in fits) is (everywhere < 1)
    assert staging._simplest(best, fits, arm).members[0][0].element == found


@pytest.mark.parametrize(("other", "found"), [(0.93, None), (1.5, "elbow")])
def test_where_either_element_would_do_all_are_named(arm, other, found):
    spread = np.linspace(-0.1, 0.1, 8)
    losses = {None: 0.925 + spread, "elbow": 0.92 - spread, "shoulder": other + spread}
    fits = [fit(candidate("joint_damping", arm, element), loss) for element, loss in losses.items()]
    assert staging._simplest(fits[1], fits, arm).members[0][0].element == found


@pytest.mark.parametrize(
    ("everywhere", "tips", "one", "found"),
    [
        (1.5, 0.92, 1.5, "fingertips"),
        (0.92, 0.92, 1.5, None),  # the support may be as slippery: not told, so not said to be spared
        (1.5, 0.922, 0.92, "index2"),  # one would do
    ],
)
def test_all_fingertips_are_named_where_one_is_too_few_and_everything_too_much(hand, everywhere, tips, one, found):
    losses = {None: everywhere, "fingertips": tips, "index2": one, "thumb_rota2": 1.5}
    fits = [fit(candidate("sliding_friction", hand, e), np.full(8, loss)) for e, loss in losses.items()]
    best = min(fits, key=lambda f: f.evidence.loss.mean())
    assert staging._simplest(best, fits, hand).members[0][0].element == found


@pytest.mark.parametrize(("probe", "left", "sharp"), [(1.6, 1.4, True), (1.6, 1.0, False), (1.98, 1.4, False)])
def test_a_rival_is_sharpened_that_may_come_near_between_its_points(arm, monkeypatch, probe, left, sharp):
    """Its loss falls steeply to its last near probe, and may go on; not where the best leaves nothing."""
    monkeypatch.setattr(staging, "null_level", lambda *a: 1.1)
    c = candidate("joint_damping", arm)
    problem = SimpleNamespace(score=SimpleNamespace(loss=lambda z: z[:, 0]))
    at, losses = c.neutral[0] + np.array([0.0, 1.0, 2.0]), np.array([2.0, probe, 3.0])
    curve = Curve(c, at, np.repeat(losses, 16).reshape(3, 8, 2), np.ones(3, bool))
    rival = Fit(((c, at[1:2]),), curve, CrossFit(BASE - probe, np.full(8, probe), np.zeros((4, 1))))
    best = fit(candidate("servo_damping", arm), np.full(8, left))
    stage = staging.Stage(BASE, np.zeros((4, len(BASE))), (best, rival), 0.0, (), (), (), 0.0)
    assert staging._may_come_near(problem, stage, rival, best) is sharp


@pytest.mark.parametrize("may", [True, False])
def test_what_may_come_near_is_compared_at_its_sharpest(arm, monkeypatch, may):
    sharp = {"joint_damping": 1.2, "servo_damping": 1.0}
    problem = sharply(arm, monkeypatch, sharp)
    monkeypatch.setattr(staging, "_may_come_near", lambda problem, stage, f, best: may)
    fits = (fit(candidate("joint_damping", arm), np.full(8, 1.2)), fit(candidate("servo_damping", arm), BASE - 0.5))
    stage = staging.Stage(BASE, np.zeros((4, len(BASE))), fits, 0.0, (), (), (), 0.0)
    assert sharpened(problem, stage).fits[0].labels == (("servo_damping",) if may else ("joint_damping",))
