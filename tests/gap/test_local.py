"""Local causes: the variants that are worth simulating are those of the element at fault."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.candidates import candidates
from candata.gap.diagnosis import _problem
from candata.gap.local import promising
from candata.gap.recordings import recordings
from candata.gap.replay import Replayer
from candata.gap.screen import respond
from candata.gap.stage import typical


@pytest.fixture(scope="module")
def variants(arm, arm_episodes, planted):
    """The function that gives the labels of the variants that an arm with a fault is searched for."""

    def find(*fault, **parameters) -> set[str]:
        rng = np.random.default_rng(0)
        recs = recordings(arm, arm_episodes(planted(*fault, **parameters) if fault else ()))
        problem = _problem(Replayer(arm), recs, rng, None, lambda stage: None)
        nominal = problem.nominal
        responses, _ = respond(problem, nominal, candidates(arm, list(recs.readings)))
        base, _ = typical(problem, nominal, ())
        return {c.label for c in promising(problem, nominal, responses, base)}

    return find


def test_a_joint_at_fault_stands_out_and_brings_every_effect_on_it(variants):
    found = variants("joint_dry_friction", "elbow", frictionloss_Nm=0.4)
    assert {"joint_dry_friction elbow", "servo_gain elbow", "torque_limit elbow"} <= found
    assert "torque_limit shoulder" not in found


def test_without_a_fault_few_variants_are_simulated(variants):
    assert len(variants()) <= 6
