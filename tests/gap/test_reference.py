"""What changed since a reference: the simulator's own misfit is no news."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.errors import DataError
from candata.gap.data.recordings import recordings
from candata.gap.measure.reference import changed_since
from candata.gap.replay.replayer import Replayer
from candata.schema.scene import Repeatability
from tests.gap.test_repeats import problem_of, runs

#: The machine as it is: its servos are late and weaker than the scene says.
LATE_S, WEAK = 0.03, 0.6


@pytest.fixture(scope="module")
def before(as_dataset, arm_episodes):
    return as_dataset(runs(arm_episodes, 3, gain=WEAK, varies=0.02, delay_s=LATE_S))


def test_another_run_of_the_same_machine_has_not_changed(arm, judge, arm_episodes, before):
    """The scene alone is far off: without the reference that is a gap."""
    again = runs(arm_episodes, 3, gain=WEAK, varies=0.02, delay_s=LATE_S, seed=9)
    report = judge(arm, again, against=before).report
    assert (report.verdict, report.effects) == ("no_gap", ())
    assert report.data.against.startswith(before.name)
    assert any(note == "12 of 12 episodes play a motion of the reference" for note in report.data.notes)
    alone = recordings(arm, again)
    played = changed_since(Replayer(arm), alone, recordings(arm, before.episodes()), "before")
    assert np.abs(played.misfit).mean() > 0.01


def test_what_changed_is_named_with_its_size(arm, judge, arm_episodes, before):
    changed = runs(arm_episodes, 3, gain=0.65 * WEAK, varies=0.02, delay_s=LATE_S, seed=9)
    report = judge(arm, changed, against=before).report
    assert [e.name for e in report.effects] == ["servo_gain"]
    assert report.effects[0].parameters["kp_scale"].value == pytest.approx(0.65, rel=0.05)
    # The scene was brought near the reference first.
    assert {"servo_gain", "actuation_delay"} <= {e.name for e in report.given_effects}


@pytest.mark.parametrize(("gain", "named"), [(1.0, []), (0.65, ["servo_gain"])])
def test_a_single_motion_that_is_repeated_tells_what_changed(arm, judge, arm_episodes, as_dataset, gain, named):
    """Its runs share the reference's error and are one piece of evidence: how far it errs, null recordings tell."""
    first, second = (runs(arm_episodes, 8, gain=g, varies=0.02, seed=s)[::4] for g, s in ((1.0, 5), (gain, 9)))
    report = judge(arm, second, against=as_dataset(first)).report
    assert [e.name for e in report.effects] == named
    assert (report.verdict == "no_gap") == (not named)


def test_motions_that_the_reference_lacks_are_compared_after_a_model_of_its_misfit(arm, arm_episodes, before):
    """The model takes part of the misfit off, and what it does not foretell joins the floor."""
    other = recordings(arm, arm_episodes((*_machine(),), count=4, seed=7))
    compared = changed_since(Replayer(arm), other, recordings(arm, before.episodes()), "before")
    assert (sum(part.variance for part in compared.slow) > 0.002**2).all()
    assert any("0 of 4 episodes play a motion" in note for note in compared.notes)
    assert any("joins the floor" in note for note in compared.notes)


@pytest.mark.parametrize("repeated", [False, True])
def test_what_the_scene_declares_is_in_the_floor_of_a_comparison_too(arm, as_dataset, arm_episodes, repeated):
    """With and without repeats, of runs that differ by noise alone."""
    scene = replace(arm, file=arm.file.model_copy(update={"repeatability": Repeatability(joint_position=0.02)}))
    first, second = (runs(arm_episodes, 3, seed=s) if repeated else arm_episodes(count=8, seed=1) for s in (5, 9))
    problem = problem_of(as_dataset, scene, second, against=as_dataset(first))
    assert (sum(part.variance for part in problem.recs.slow) >= 0.02**2 - 1e-12).all()


def test_a_report_names_its_reference_however_it_ends(arm, judge, arm_episodes, before):
    few = judge(arm, arm_episodes(count=4), against=before).report
    spent = judge(arm, arm_episodes(count=8), against=before, budget=0.1).report
    assert (few.verdict, spent.verdict) == ("too_little_data", "out_of_budget")
    assert few.data.against == spent.data.against
    assert few.data.against.startswith(before.name)


def test_a_reference_without_shared_channels_or_of_tosses_is_refused(arm, cube, arm_episodes, played):
    recs = recordings(arm, arm_episodes(count=2))
    with pytest.raises(DataError, match="share no channel"):
        changed_since(Replayer(arm), recs, replace(recs, readings={}), "x")
    tosses = recordings(cube, played(cube, count=2, duration_s=0.6))
    with pytest.raises(DataError, match="tosses cannot be compared"):
        changed_since(Replayer(cube), tosses, tosses, "x")


def _machine():
    from candata.schema.effect import EffectSetting

    return (
        EffectSetting(name="servo_gain", parameters={"kp_scale": WEAK}),
        EffectSetting(name="actuation_delay", parameters={"delay_s": LATE_S}),
    )
