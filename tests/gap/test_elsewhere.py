"""A fault of one element gives way to that of all, where in a world of its own spread that leaves less."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap import elsewhere, worth
from candata.gap.candidates import candidate
from candata.gap.diagnosis import _problem
from candata.gap.recordings import recordings
from candata.gap.refine import joint
from candata.gap.replay import Replayer
from candata.gap.streams import Streams
from candata.scenes import load_scene


@pytest.fixture(scope="module")
def one_joint(arm, arm_episodes, planted):
    """The problem that another cause beside a late joint poses, and the fit of that joint."""
    effects = (*planted("joint_damping", damping_Nms_rad=0.3), *planted("actuation_delay", "elbow", delay_s=0.03))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    elbow = (candidate("actuation_delay", arm, "elbow"), np.array([0.03]))
    return problem, joint(problem, (elbow,), problem.score.loss(problem.nominal))


@pytest.mark.parametrize(("share", "near", "taken"), [(0.4, True, True), (0.6, True, False), (0.4, False, False)])
def test_what_leaves_half_by_its_own_spread_is_taken_where_it_is_as_good_by_the_other(
    one_joint, monkeypatch, share, near, taken
):
    problem, best = one_joint
    assert elsewhere.moved(problem, best) is None
    asked = []

    def rescored(problem, fit):
        asked.append(fit.labels)
        loss = np.full(len(problem.recs), 1 + share * worth.left_by(best))
        return problem, replace(fit, evidence=replace(fit.evidence, loss=loss))

    monkeypatch.setattr(elsewhere, "rescored", rescored)
    monkeypatch.setattr(elsewhere, "is_tied", lambda *a: near)
    monkeypatch.setattr(elsewhere, "_is_better", lambda *a: False)
    found = elsewhere.moved(problem, best)
    assert (found is not None) is taken
    if near:
        assert asked == [("actuation_delay",)]
    if taken:
        assert found.labels == ("actuation_delay",)


@pytest.mark.parametrize(
    ("name", "element", "numbers", "found"),
    [
        ("torque_limit", "thumb_base", [0.19], [("torque_limit thumb", [0.19])]),
        ("joint_offset", "thumb_end", [0.05], [("joint_offset thumb", [0.0, 0.05])]),
        ("sliding_friction", "left_tip", [-0.7], [("sliding_friction fingertips", [-0.7])]),
        ("sliding_friction", "fingertips", [-0.7], []),
    ],
)
def test_a_fault_is_as_strong_on_the_groups_that_hold_its_element(name, element, numbers, found):
    scene = load_scene("gripper_tabletop")
    problem = SimpleNamespace(replayer=SimpleNamespace(scene=scene))
    some = elsewhere.groups(problem, candidate(name, scene, element), np.array(numbers))
    assert [(c.label, u.tolist()) for c, u in some] == found


def test_a_fault_of_all_joints_is_taken_for_that_of_the_one_that_explains_more(arm, arm_episodes, planted):
    recs = recordings(arm, arm_episodes(planted("actuation_delay", "shoulder", delay_s=0.03), count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    everywhere = (candidate("actuation_delay", arm), np.array([0.03]))
    wrong = joint(problem, (everywhere,), problem.score.loss(problem.nominal))
    assert worth.left_by(wrong) > worth.OPEN
    found = elsewhere.moved(problem, wrong)
    assert found.labels == ("actuation_delay shoulder",)
    assert worth.left_by(found) < 0.2 * worth.left_by(wrong)


def test_two_faults_of_one_joint_become_those_of_all_joints_together(arm, arm_episodes, planted, monkeypatch):
    effects = (*planted("joint_dry_friction", frictionloss_Nm=0.3), *planted("actuation_delay", delay_s=0.03))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    base = problem.score.loss(problem.nominal)
    some = [
        (candidate(name, arm, "elbow"), np.full(1, value))
        for name, value in (("joint_dry_friction", 0.3), ("actuation_delay", 0.03))
    ]
    wrong = joint(problem, tuple(some), base)
    monkeypatch.setattr(elsewhere, "sharpest", lambda problem, light: None)  # as if none moved alone explained more
    found = elsewhere.moved(problem, wrong)
    assert found.labels == ("joint_dry_friction", "actuation_delay")
    assert worth.left_by(found) < 0.1 * worth.left_by(wrong)
    alone = joint(problem, tuple(some[:1]), base)
    assert elsewhere._spread_together(problem, alone) is None, "one is moved alone"
    monkeypatch.setattr(elsewhere, "is_on_slides", lambda c, scene: True)
    assert elsewhere._spread_together(problem, wrong) is None, "the effect as a whole spares what is on slides"
    monkeypatch.undo()
    only_here = (
        *planted("joint_dry_friction", "elbow", frictionloss_Nm=0.3),
        *planted("actuation_delay", "elbow", delay_s=0.03),
    )
    recs = recordings(arm, arm_episodes(only_here, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    base = problem.score.loss(problem.nominal)
    assert elsewhere._spread_together(problem, joint(problem, tuple(some), base)) is None


@pytest.mark.parametrize(
    ("elements", "label"), [(("shoulder", "elbow"), "joint_offset elbow"), (("shoulder",), "joint_offset")]
)
def test_of_all_numbers_only_those_of_the_elements_at_fault_are_kept(arm, arm_episodes, planted, elements, label):
    recs = recordings(arm, arm_episodes(planted("joint_offset", "elbow", offset_rad=0.06), count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    fit = joint(
        problem, ((candidate("joint_offset", arm), np.array([0.001, 0.06])),), problem.score.loss(problem.nominal)
    )
    variants = [candidate("joint_offset", arm, element) for element in elements]
    assert elsewhere._of_fewer_numbers(problem, fit, variants).labels == (label,)


def test_a_fault_moved_to_all_joints_keeps_to_the_group_that_explains_as_much(arm, arm_episodes, planted, monkeypatch):
    recs = recordings(arm, arm_episodes(planted("joint_offset", "elbow", offset_rad=0.06), count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    base, elbow = problem.score.loss(problem.nominal), candidate("joint_offset", arm, "elbow")
    blunt = joint(problem, ((elbow, np.array([0.06])),), base)
    off = replace(blunt, evidence=replace(blunt.evidence, loss=blunt.evidence.loss + 1.0))
    whole = joint(problem, ((candidate("joint_offset", arm), np.array([0.001, 0.06])),), base)
    monkeypatch.setattr(elsewhere, "sharpest", lambda problem, light: whole)
    monkeypatch.setattr(elsewhere, "groups", lambda problem, c, u: ((elbow, u),))
    assert elsewhere.moved(problem, off).labels == ("joint_offset elbow",)
    monkeypatch.setattr(elsewhere, "groups", lambda problem, c, u: ())
    assert elsewhere.moved(problem, off).labels == ("joint_offset",)
