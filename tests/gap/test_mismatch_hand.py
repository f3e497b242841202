"""Mismatch on a hand of many fingers: faults of joints and fingertips are found, in all episodes or in some."""

from __future__ import annotations

import re

import numpy as np
import pytest

from candata.effects import effect, effect_names
from candata.gap.data.recordings import recordings
from candata.gap.mismatch.check import checked, mismatch
from candata.gap.replay.replayer import Replayer
from candata.schema.episode import Episode
from tests.gap.recording_faults import FAULTS, Change, changed, channel, columns, drawn, found


@pytest.fixture(scope="module")
def handled(hand, played) -> list[Episode]:
    return played(hand, policies=("grasp_lift_shake", "push", "free_sweep"), count=6)


@pytest.fixture(scope="module")
def grasped(hand, played) -> list[Episode]:
    return played(hand, policies=("grasp_lift_shake", "free_sweep", "squeeze", "roll"), count=12)


HAND_FAULTS = {k: v for k, v in FAULTS.items() if k != "later 3"} | {
    "swapped": (columns("action", [3, 7], lambda a: a[:, ::-1]), "swapped_commands"),
    "joints swapped": (columns("joint_position", [3, 7], lambda q: q[:, ::-1]), "swapped_joints"),
    "tips swapped": (columns("fingertip_force", [1, 2], lambda f: f[:, ::-1]), "swapped_fingertips"),
    "tips in a cycle": (columns("fingertip_force", [0, 2, 4], lambda f: f[:, [1, 2, 0]]), "swapped_fingertips"),
    "cycle": (columns("action", [3, 4, 5], lambda a: a[:, [1, 2, 0]]), "swapped_commands"),
    "degrees": (columns("action", range(3, 15), np.degrees), "command_unit"),
    "tip in gf": (columns("fingertip_force", [3], lambda f: f / 9.80665e-3), "force_unit"),
    "x y z w": (channel("object_pose", lambda p: p[:, [0, 1, 2, 4, 5, 6, 3]]), "quaternion_order"),
}


#: Faults that the fast suite finds on grippers alone (`test_mismatch.py`, `tests/checks/test_silent_mistakes.py`): on
#: many joints each asks for a simulation of every pair. A cycle of fingertips is found as an exchange of two is.
ON_GRIPPERS = (
    "later 1",
    "dead",
    "force sign",
    "force turned",
    "force in mN",
    "force in gf",
    "force in kgf",
    "tips in a cycle",
)


@pytest.mark.parametrize(
    "fault", [pytest.param(f, marks=pytest.mark.slow) if f in ON_GRIPPERS else f for f in HAND_FAULTS]
)
def test_a_fault_of_a_hand_is_found(hand, handled, fault):
    change, kind = HAND_FAULTS[fault]
    assert found(hand, changed(hand, handled, change))[0] == (kind, True)


#: Faults that some episodes have, and what the message says of where.
PARTS: dict[str, tuple[Change, str, str]] = {
    "commands": (columns("action", [3, 7], lambda a: a[:, ::-1]), "swapped_commands", "`action` in the order"),
    "joints": (columns("joint_position", [3, 7], lambda q: q[:, ::-1]), "swapped_joints", "`joint_position` in the"),
    "tips": (columns("fingertip_force", [1, 2], lambda f: f[:, ::-1]), "swapped_fingertips", "`fingertip_force` in"),
}


@pytest.mark.parametrize("every", [2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("part", PARTS)
def test_an_exchange_in_some_episodes_is_found_and_they_are_named(hand, grasped, part, every):
    change, kind, fix = PARTS[part]
    mixed = [changed(hand, [e], change)[0] if i % every == 0 else e for i, e in enumerate(grasped)]
    (one,) = mismatch(Replayer(hand), recordings(hand, mixed))
    assert (one.kind, one.definite) == (kind, True)
    assert fix in one.fix
    # Those without a touch, or in which a joint hardly moves, have no say.
    named = set(re.findall(r"e\d\d\d", one.found))
    assert len(named) >= 2
    assert named <= {e.meta.id for e in grasped[::every]}


#: Effects on top of which faults are found, and are not told without one.
EFFECTS = {
    "heavy": ("object_mass", None, {"mass_scale": 1.5}),
    "slippery": ("sliding_friction", None, {"scale": 0.5}),
    "numb": ("tactile_gain", None, {"gain": 0.7}),
    "tared": ("tactile_bias", None, {"bias_N": (0.3, -0.2, 0.4) * 5}),
    "weak": ("torque_limit", "index1", {"limit_Nm": 0.15}),
}


@pytest.mark.parametrize(
    "name", [n if n in ("slippery", "numb") else pytest.param(n, marks=pytest.mark.slow) for n in EFFECTS]
)
def test_exchanged_tips_and_a_unit_are_found_on_top_of_an_effect(hand, played, planted, name):
    cause, element, numbers = EFFECTS[name]
    made = played(hand, planted(cause, element, **numbers), count=6, policies=("grasp_lift_shake", "squeeze"))
    assert found(hand, made) == []
    # Slipping, index and middle finger feel alike; the thumb does not.
    exchanged = columns("fingertip_force", [0, 4], lambda f: f[:, ::-1])
    assert found(hand, changed(hand, made, exchanged)) == [("swapped_fingertips", True)]
    assert found(hand, changed(hand, made, FAULTS["force in kgf"][0])) == [("force_unit", True)]


def test_a_dead_fingertip_is_not_taken_for_an_exchange_and_does_not_hide_one(hand, handled):
    dead = changed(hand, handled, columns("fingertip_force", [4], lambda f: 0 * f))
    assert found(hand, dead) == []
    assert found(hand, changed(hand, dead, HAND_FAULTS["tips swapped"][0])) == [("swapped_fingertips", True)]


def test_sound_recordings_of_a_hand_have_no_finding(hand, handled):
    assert found(hand, handled) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", effect_names())
def test_no_effect_on_a_hand_is_taken_for_a_fault(hand, played, name):
    if not effect(name).possible(hand):
        pytest.skip("cannot act in this scene")
    motions = ((), ("free_sweep", "push"), ("grasp_lift_shake",), ("squeeze", "roll"))
    for seed, policies in enumerate(motions):
        made = played(hand, (drawn(hand, name, seed),), count=6, seed=100 + seed, policies=policies)
        assert not any(definite for _, definite in found(hand, made))


def test_forces_turned_about_their_normal_are_noted(hand, handled):
    turned = changed(
        hand, handled, channel("fingertip_force", lambda f: np.stack([-f[..., 1], f[..., 0], f[..., 2]], -1))
    )
    assert found(hand, turned)[0][0] == "force_frame"


def test_one_dead_joint_is_held_where_it_was_and_left_out(hand, handled):
    joint = hand.file.joints.index("index1")
    dead = changed(hand, handled, columns("joint_position", [joint], lambda q: 0 * q + q[:1]))
    kept = checked(Replayer(hand), recordings(hand, dead))
    assert ["still: index1" in n for n in kept.notes] == [True]
    # After the tenth of a second from which a replay starts.
    assert np.isnan(kept.readings["joint_position"][:, 8:, joint]).all()
    assert np.isfinite(kept.readings["joint_position"][:, :, joint + 1]).all()
    held = np.array([e["joint_position"][0, joint] for e in dead])
    assert kept.commands[:, :, joint] == pytest.approx(np.repeat(held[:, None], kept.commands.shape[1], axis=1))
