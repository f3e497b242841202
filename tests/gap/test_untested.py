"""What was not recorded cannot be tested, and what cannot act cannot be asked for: both are said."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import UnknownNameError, UsageError
from candata.gap.data.recordings import recordings
from candata.gap.data.testability import library, untested, untested_notes
from candata.gap.mismatch.check import checked
from candata.gap.mismatch.poses import NOTE, widened
from candata.gap.replay.replayer import Replayer
from candata.schema.episode import Episode

FORCES = ("fingertip_force", "fingertip_contact", "contact")


@pytest.fixture(scope="module")
def handled(hand, played) -> list[Episode]:
    return played(hand, policies=("grasp_lift_shake", "free_sweep"), count=4, duration_s=1.2)


def without(episodes: list[Episode], *channels: str) -> list[Episode]:
    return [Episode(e.meta, {k: v for k, v in e.arrays.items() if k not in channels}) for e in episodes]


def test_with_every_channel_everything_can_be_tested(hand, handled):
    assert untested(hand, recordings(hand, handled)) == {}


def test_without_forces_touch_cannot_be_tested(hand, handled):
    recs = recordings(hand, without(handled, *FORCES))
    expected = ("tactile_bias", "tactile_dead_band", "tactile_gain", "tactile_lag")
    assert untested(hand, recs) == {"fingertip_force": expected}
    assert untested_notes(hand, recs) == (f"no fingertip_force: {', '.join(expected)} could not be tested",)
    assert checked(Replayer(hand), recs).notes == untested_notes(hand, recs)


def test_without_poses_and_forces_the_object_cannot_be_tested(hand, handled):
    found = untested(hand, recordings(hand, without(handled, "object_pose", *FORCES)))
    assert {"object_mass", "sliding_friction"} <= set(found["fingertip_force or object_pose"])
    assert "pose_bias" in found["object_pose"]


def test_without_the_objects_place_contact_is_not_compared(hand, handled):
    recs = recordings(hand, without(handled, "object_pose"))
    kept = checked(Replayer(hand), recs)
    assert NOTE in kept.notes
    assert list(kept.readings) == ["joint_position"]
    touched = np.stack([e["contact"] for e in handled])
    assert touched.any()
    assert np.isnan(kept.readings["joint_position"][touched]).all()
    assert np.isfinite(kept.readings["joint_position"]).mean() > 0.2


def test_without_joints_the_object_is_still_compared(hand, handled):
    kept = checked(Replayer(hand), recordings(hand, without(handled, "joint_position")))
    assert set(kept.readings) == {"object_pose", "fingertip_force"}


def test_an_unknown_effect_is_refused_with_the_nearest(hand, handled):
    with pytest.raises(UnknownNameError, match="did you mean 'object_mass'"):
        library(hand, recordings(hand, handled), ("object_mas",))


def test_an_effect_that_cannot_act_here_is_refused(arm, arm_episodes):
    with pytest.raises(UsageError, match="effect object_mass cannot act in scene"):
        library(arm, recordings(arm, arm_episodes()), ("object_mass",))


def test_an_effect_that_cannot_show_here_is_refused(hand, handled):
    with pytest.raises(UsageError, match="expected: channel fingertip_force"):
        library(hand, recordings(hand, without(handled, *FORCES)), ("tactile_gain",))


def test_the_library_is_what_can_act_and_show(arm, arm_episodes):
    recs = recordings(arm, arm_episodes())
    assert "joint_damping" in library(arm, recs)
    assert not {"object_mass", "tactile_gain"} & set(library(arm, recs))
    assert library(arm, recs, ("servo_gain",)) == ("servo_gain",)


def test_flags_widen_both_ways():
    flags = np.zeros((1, 8), bool)
    flags[0, 3] = True
    assert widened(flags, 1, 2)[0].tolist() == [False, False, True, True, True, True, False, False]
