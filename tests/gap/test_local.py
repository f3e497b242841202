"""Local causes: the variants that are worth simulating are those of the element at fault."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate, candidates
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening.elements import promising
from candata.gap.screening.look import typical
from candata.gap.screening.signature_screen import respond
from candata.simulate.episodes import EpisodeJob, make_episodes


@pytest.fixture(scope="module")
def variants(arm, arm_episodes, planted):
    """The function that gives the labels of the variants that an arm with a fault is searched for."""

    def find(*fault, **parameters) -> set[str]:
        recs = recordings(arm, arm_episodes(planted(*fault, **parameters) if fault else ()))
        problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
        nominal = problem.nominal
        responses, _ = respond(problem, nominal, candidates(arm, list(recs.readings)))
        base, _ = typical(problem)
        return {c.label for c in promising(problem, nominal, responses, base)}

    return find


def test_a_joint_at_fault_stands_out_and_brings_every_effect_on_it(variants):
    found = variants("joint_dry_friction", "elbow", frictionloss_Nm=0.4)
    assert {"joint_dry_friction elbow", "servo_gain elbow", "torque_limit elbow"} <= found
    assert "torque_limit shoulder" not in found


def test_without_a_fault_few_variants_are_simulated(variants):
    assert len(variants()) <= 6


def test_a_fingertip_that_stands_out_brings_no_joint_of_its_name(hand):
    """In the built-in hand both are called index2: places for variants go to the joint and the tip that stand out."""
    made = make_episodes(
        hand, [EpisodeJob(f"e{i}", i, "squeeze", 3) for i in range(8)], duration_s=0.5, noise=hand.file.noise
    )
    problem = _problem(Replayer(hand), recordings(hand, made), Streams(0), None, lambda stage: None)
    force = np.array([(c, e.split(" ")[0]) == ("fingertip_force", "index2") for c, e, _ in problem.plan.columns])
    own = np.tile(force, problem.plan.phase.shape[1])
    here = np.where(own, problem.nominal + 30, 0).astype(np.float32)  # nothing is left for any joint to explain
    some = [
        candidate(name, hand)
        for name in ("servo_gain", "joint_damping", "armature", "tactile_gain", "tactile_bias", "sliding_friction")
    ]
    responses, _ = respond(problem, here, some)
    found = {c.label for c in promising(problem, here, responses, problem.score.loss(here))}
    assert {"tactile_gain index2", "tactile_bias index2"} <= found
    assert not found & {"servo_gain index2", "joint_damping index2", "armature index2"}
    assert "servo_gain wrist" in found, "what the effect does on hinges says nothing of slides"
    assert "sliding_friction table" in found, "what it does on all says nothing of what has no readings"
