"""Two effects tried together: what the one taken made up for, both explain."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.effects import effects_with
from candata.gap import added, sets, trials, worth
from candata.gap.candidates import candidate, probes
from candata.gap.diagnosis import _problem
from candata.gap.recordings import recordings
from candata.gap.refine import WIDTHS, joint
from candata.gap.replay import Replayer
from candata.gap.shortlist import brief
from candata.gap.stage import look
from candata.gap.streams import Streams
from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.gap.conftest import members, step_problem


@pytest.mark.parametrize(("unsure", "finished"), [(0.0, 1), (np.inf, 2)])
def test_rivals_that_stay_near_alone_are_fitted_on(arm, arm_episodes, planted, monkeypatch, unsure, finished):
    """Two sets that nothing tells apart at first: the one that is clearly worse after one width is left there."""
    recs = recordings(arm, arm_episodes(planted("joint_damping", damping_Nms_rad=0.4), count=12))
    problem = step_problem(arm, recs)
    base = problem.score.loss(problem.nominal)
    made = []

    def counted(problem, members, base, widths=WIDTHS):
        made.append((members[0][0].name, widths))
        return joint(problem, members, base, widths)

    light = [
        joint(problem, ((candidate(name, arm), np.full(1, value)),), base, widths=())
        for name, value in (("joint_damping", 0.3), ("servo_damping", 1.0))
    ]
    alike = [replace(f, evidence=light[0].evidence) for f in light]
    monkeypatch.setattr(trials, "joint", counted)
    monkeypatch.setattr(trials, "UNSURE", np.inf)
    tied = trials.is_tied
    monkeypatch.setattr(
        trials, "is_tied", lambda f, best, errors: any(f is one for one in alike) or tied(f, best, unsure)
    )
    assert trials.sharpest(problem, alike).labels == ("joint_damping",)
    assert [widths for _, widths in made] == [WIDTHS[:1]] * 2 + [WIDTHS[1:]] * finished
    assert trials.sharpest(problem, []) is None


@pytest.mark.parametrize(
    ("left", "gain", "extra", "promising"),
    [
        (1.0, 1.0, 0.08, True),  # an eighth of 0.6 floors
        (1.0, 1.0, 0.07, False),
        (0.1, 2.0, 0.03, True),  # half of what ends the search
        (0.1, 2.0, 0.02, False),
        (1.0, 9.0, 0.2, False),  # a name beside so much must be worth more
    ],
)
def test_a_light_fit_that_takes_a_part_is_fitted_on(left, gain, extra, promising):
    best = SimpleNamespace(gain=gain, evidence=SimpleNamespace(loss=np.full(12, 1 + left)))
    grown = SimpleNamespace(evidence=SimpleNamespace(loss=np.full(12, 1 + left - extra)))
    assert trials.promises_more(best, grown) is promising


def test_what_promises_nothing_beside_a_set_is_not_fitted_sharply(arm, arm_episodes, planted, monkeypatch):
    recs = recordings(arm, arm_episodes(planted("joint_damping", damping_Nms_rad=0.4), count=12))
    problem = step_problem(arm, recs)
    base = problem.score.loss(problem.nominal)
    best = joint(problem, ((candidate("servo_gain", arm), np.full(1, 0.01)),), base, widths=())
    idle = [(*best.members, (candidate("armature", arm), np.full(1, 1e-5)))]
    true = [(*best.members, (candidate("joint_damping", arm), np.full(1, 0.3)))]
    assert trials.sharp(problem, true, best).labels == ("servo_gain", "joint_damping")
    monkeypatch.setattr(trials, "promises_more", lambda *a: False)
    assert trials.sharp(problem, true, best) is None
    assert trials.sharp(problem, idle).labels == ("servo_gain", "armature")
    choice = candidate("time_step", arm)
    other = next(u for u in probes(choice, arm) if not choice.is_neutral(u))
    assert trials.sharp(problem, [(*best.members, (choice, other))], best).labels == ("servo_gain", "time_step")


def test_of_many_that_cannot_be_told_apart_only_the_first_few_are_fitted_on():
    fits = [
        SimpleNamespace(plane=SimpleNamespace(at=np.zeros(1)), gain=1 - 0.001 * i, evidence=SimpleNamespace(loss=loss))
        for i, loss in enumerate(np.full((6, 12), 1.0) + 0.001 * np.arange(6)[:, None])
    ]
    assert trials._untold(fits[::-1]) == fits[: 1 + trials.RIVALS]


def test_two_that_do_much_alike_share_what_the_one_taken_made_up_for(arm, arm_episodes, planted):
    effects = (*planted("servo_damping", kv_scale=3.0), *planted("joint_damping", damping_Nms_rad=0.4))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = step_problem(arm, recs)
    base = problem.score.loss(problem.nominal)
    fits = [
        joint(problem, ((candidate(name, arm), np.full(1, value)),), base)
        for name, value in (("servo_damping", 1.5), ("joint_damping", 1.0), ("armature", 0.01))
    ]
    best = fits[0]
    assert worth.left_by(best) > worth.LEFT
    found = trials.shared(problem, best, fits)
    truth = {"servo_damping": np.log(3.0), "joint_damping": 0.4}
    assert {c.name: u[0] for c, u in found.members} == pytest.approx(truth, rel=0.1)
    assert trials.shared(problem, best, fits[:1]) is None  # nothing to share with
    assert trials.shared(problem, found, fits) is None  # nothing left to explain


@pytest.mark.parametrize("best", [0.5, 1.0])
def test_of_two_that_do_much_alike_either_beginning_may_lead_on(monkeypatch, best):
    """Damping of the joints beside less of the servos, for which more of the servos stood, lies far from their half."""
    a, b = (SimpleNamespace(name=name, neutral=np.zeros(1)) for name in ("servo_damping", "joint_damping"))
    monkeypatch.setattr(
        trials,
        "joint",
        lambda part, members, *rest: SimpleNamespace(
            members=members, plane=SimpleNamespace(z=abs(members[-1][1][0] / 2 - best))
        ),
    )
    part = SimpleNamespace(score=SimpleNamespace(loss=np.array))
    found = trials._split(part, (), (a, np.ones(1)), (b, np.full(1, 2.0)), np.zeros(1))
    assert [(c.name, float(u[0])) for c, u in found.members] == [
        ("servo_damping", 1 - best),
        ("joint_damping", 2 * best),
    ]


@pytest.mark.parametrize(("left", "fitted"), [(1.45, False), (1.4, True)])
def test_what_takes_too_little_of_a_few_episodes_is_not_fitted_on_all(monkeypatch, left, fitted):
    """Of half a floor an eighth is asked for there: half of the quarter that the next effect must take."""

    def fit(name):
        c = SimpleNamespace(name=name, label=name, choices=(), neutral=np.zeros(1))
        gain = np.ones(12)
        return SimpleNamespace(members=((c, np.ones(1)),), gain=1.0, evidence=SimpleNamespace(gain=gain))

    best, made = fit("servo_gain"), []
    score = SimpleNamespace(loss=lambda z: np.full(6, z))
    part = SimpleNamespace(score=score, nominal=2.0)
    problem = SimpleNamespace(measured=())
    monkeypatch.setattr(trials, "left_by", lambda best: 0.5)
    monkeypatch.setattr(trials, "brief", lambda problem: (part, np.arange(1)))
    monkeypatch.setattr(trials, "here_of", lambda problem, best: np.full(1, 1.5))
    plane = SimpleNamespace(z=left)
    monkeypatch.setattr(trials, "joint", lambda part, members, *a: SimpleNamespace(members=members, plane=plane))
    monkeypatch.setattr(trials, "sharp", lambda problem, sets: made.extend(sets))
    assert trials.shared(problem, best, [best, fit("armature")]) is None
    assert len(made) == fitted


def test_in_a_full_set_the_one_that_shares_takes_the_place_of_what_made_up_for_it(
    arm, arm_episodes, planted, monkeypatch
):
    effects = (*planted("servo_damping", kv_scale=3.0), *planted("joint_damping", damping_Nms_rad=0.4))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = step_problem(arm, recs)
    base = problem.score.loss(problem.nominal)
    servos, joints, inertia = [
        (candidate(name, arm), np.full(1, value))
        for name, value in (("servo_damping", 1.5), ("joint_damping", 1.0), ("armature", 0.01))
    ]
    alone = [joint(problem, (m,), base) for m in (servos, joints)]
    full = joint(problem, (servos, inertia), base)
    monkeypatch.setattr(worth, "LARGEST", 2)
    assert trials.least_worth(problem, full, ())[0][0].name == "armature"
    assert [c.name for c, _ in trials.least_worth(problem, full, ("armature",))] == ["servo_damping"]
    found = trials.shared(problem, full, alone)
    truth = {"servo_damping": np.log(3.0), "joint_damping": 0.4}
    assert {c.name: u[0] for c, u in found.members} == pytest.approx(truth, rel=0.1)


def test_a_pair_begins_at_shares_of_what_each_explains_alone(arm, arm_episodes, planted):
    """Both slow the arm: what each does alone adds up to too much."""
    effects = (*planted("joint_damping", damping_Nms_rad=0.6), *planted("servo_gain", kp_scale=0.6))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = step_problem(arm, recs)
    part, _ = brief(problem)
    rough = look(problem, problem.nominal, ()).rough
    (members,) = added._started(part, rough)
    assert {c.name for c, _ in members} == {"joint_damping", "servo_gain"}
    alone = {c.name: (c, u) for c, u in added._strongest(part, rough)}
    loss, best, full = (
        added.by_loss(part, [some])[0][0]
        for some in (members, (alone["servo_damping"],), (alone["joint_damping"], alone["servo_gain"]))
    )
    assert loss < best < full
    assert added._started(part, [r for r in rough if r[0].name == "servo_gain"]) == []


def test_the_two_numbers_of_one_spring_and_damper_are_found_together(planted):
    scene = load_scene("gripper_tabletop")
    truth = {"contact_compliance": 0.05, "contact_damping": 0.4}
    effects = (*planted("contact_compliance", timeconst_s=0.05), *planted("contact_damping", dampratio=0.4))
    jobs = [EpisodeJob(f"e{i}", i, ("squeeze", "push")[i % 2], 3, effects) for i in range(6)]
    recs = recordings(scene, make_episodes(scene, jobs, duration_s=1.2, noise=scene.file.noise))
    problem = _problem(Replayer(scene), recs, Streams(0), None, lambda stage: None)
    both = [(candidate(name, scene), None) for name in effects_with("contact_spring")]
    (found,) = added._coupled(problem, both)
    assert {c.name: float(np.exp(u[0])) for c, u in found} == pytest.approx(truth, rel=0.15)
    assert added._coupled(problem, both[:1]) == []


def test_a_pair_that_gains_at_no_share_is_not_fitted(arm, two_causes, monkeypatch):
    problem, base = two_causes
    best = joint(problem, members(arm, actuation_delay=0.03), base)
    harmful = [joint(problem, members(arm, **{name: 0.0}), base) for name in ("joint_damping", "armature")]
    alone = [
        replace(f, members=members(arm, **{name: value}), evidence=best.evidence)
        for f, (name, value) in zip(harmful, (("joint_damping", 5.0), ("armature", 0.5)), strict=True)
    ]
    monkeypatch.setattr(trials, "joint", lambda *_: pytest.fail("it was fitted"))
    assert trials.paired(problem, best, alone) is None


@pytest.mark.parametrize(
    ("alone", "both", "names", "found"),
    [
        (0.148, 0.66, 2, True),  # what needs another: by itself a little less than a quarter of 0.6 floors
        (0.148, 0.2, 2, False),  # the two are not worth a name each
        (0.05, 0.76, 2, False),  # by itself it is worth nothing
        (0.148, 0.76, 3, False),  # no room
    ],
)
def test_what_takes_too_little_by_itself_is_kept_with_what_it_makes_room_for(monkeypatch, alone, both, names, found):
    def fit(loss, count):
        some = tuple((SimpleNamespace(name=name), None) for name in "abcd"[:count])
        return SimpleNamespace(
            members=some, evidence=SimpleNamespace(loss=np.full(12, loss), gain=np.full(12, 10 - loss)), gain=2.2
        )

    problem = SimpleNamespace(measured=(), recs=SimpleNamespace(tasks=()))
    best, grown, two = fit(9.0, names - 1), fit(9.0 - alone, names), fit(9.0 - both, names + 1)
    monkeypatch.setattr(sets, "_next", lambda problem, held: two if held is grown else pytest.fail("not beside it"))
    assert sets._further(problem, best, grown) is (two if found else None)
    assert sets._further(problem, best, None) is None
