"""The baselines: each finds a plain cause on its own terms, and fails where its rule must."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.blind.baselines import SEARCHES, baseline_reports
from candata.gap.blind.bed import make_bed
from candata.gap.blind.signatures import least_squares, signatures
from candata.schema.bench import Label, OutsideCause
from candata.schema.effect import EffectSetting

GAIN = EffectSetting(name="servo_gain", parameters={"kp_scale": 0.7})


@pytest.fixture(scope="module")
def weak(arm_episodes, as_dataset):
    """Recordings of an arm whose servos are weak."""
    return as_dataset(arm_episodes((GAIN,), rows=80))


@pytest.fixture(scope="module")
def reports(arm, weak):
    """What every baseline says of the weak arm."""
    label = Label(case="c", kind="one", effects=(GAIN,))
    methods = (*SEARCHES, "commonest", "oracle")
    return {m: r for m, (r, _) in baseline_reports(weak, arm, label, methods, 0, "joint_damping").items()}


@pytest.mark.parametrize("method", ["lowest_error", "bic", "one_se", "oracle"])
def test_a_plain_cause_is_found(reports, method):
    first = reports[method].effects[0]
    assert first.name == "servo_gain"
    # Half the way between identity and truth at least; interpolation between probes is coarse.
    assert first.parameters["kp_scale"].value == pytest.approx(0.7, abs=0.1)


def test_the_oracle_finds_the_number_and_closes_the_gap(reports):
    (found,) = reports["oracle"].effects
    # 1 mrad of encoder noise over 4 episodes leaves far less than a per cent of stiffness.
    assert found.parameters["kp_scale"].value == pytest.approx(0.7, rel=0.02)
    assert reports["oracle"].gap.closed > 0.95


def test_the_commonest_cause_is_named_whatever_the_data(reports):
    assert [e.name for e in reports["commonest"].effects] == ["joint_damping"]
    assert reports["commonest"].gap.closed < reports["oracle"].gap.closed


def test_the_oracle_says_nothing_of_a_null_and_is_told_of_outside_causes(arm, arm_episodes, as_dataset):
    dataset = as_dataset(arm_episodes(rows=80))
    null = baseline_reports(dataset, arm, Label(case="c", kind="null"), ("oracle",), 0, "servo_gain")
    assert null["oracle"][0].verdict == "no_gap"
    hidden = Label(case="c", kind="outside", outside=OutsideCause(name="cogging", acts_on="joint"))
    told = baseline_reports(dataset, arm, hidden, ("oracle",), 0, "servo_gain")["oracle"][0]
    assert (told.verdict, told.unknown.acts_on) == ("unknown_effect", "joint")


def test_lowest_error_names_something_even_where_there_is_nothing(arm, arm_episodes, as_dataset):
    dataset = as_dataset(arm_episodes(rows=80))
    found = baseline_reports(dataset, arm, Label(case="c", kind="null"), ("lowest_error",), 0, "servo_gain")
    assert len(found["lowest_error"][0].effects) == 1


def test_a_signature_reads_its_own_probes(arm, weak):
    bed = make_bed(weak, arm, np.random.default_rng(0), 4)
    nominal, found = signatures(bed)
    gain = next(s for s in found if s.candidate.name == "servo_gain")
    for u in gain.at:
        true = bed.residuals([(gain.candidate.setting(np.array([u]), arm),)])[0]
        # Stored as float32.
        assert nominal + gain.read(np.array([u])) == pytest.approx(true, abs=1e-3, rel=1e-3)


def test_least_squares_undoes_a_known_step():
    rng = np.random.default_rng(0)
    slope = rng.standard_normal((3, 4, 50)).astype(np.float32)
    step = np.array([0.5, -2.0, 1.0])
    here = -np.tensordot(step.astype(np.float32), slope, 1)
    assert least_squares(here, slope) == pytest.approx(step, rel=1e-3)
