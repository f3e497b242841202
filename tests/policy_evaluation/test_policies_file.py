"""The file of policies: what its sources mean, and what is refused with one clear error."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import CandataError, UsageError
from candata.policies import Goal, Motion, write_motions
from candata.policy_evaluation.goals import check_held, parsed_goal
from candata.policy_evaluation.policies import read_policies


def test_noise_grows_and_is_the_same_for_a_start_whatever_others_there_are(gripper, starts, policies):
    script = {"source": "grasp_lift_shake"}
    path = policies({"name": "clean", **script}, {"name": "shaky", **script, "noise_share": 0.1})
    clean, shaky = read_policies(path, gripper)
    orders = [policy.orders(gripper, starts, 1, 1.0).commands for policy in (clean, shaky)]
    assert np.abs(orders[1] - orders[0]).max() > 0
    alone = shaky.orders(gripper, starts.take([2]), 1, 1.0).commands
    np.testing.assert_array_equal(alone[0], orders[1][2])
    assert not np.array_equal(orders[1], shaky.orders(gripper, starts, 2, 1.0).commands)


def test_a_motion_of_a_command_file_lasts_as_long_as_the_episode(gripper, starts, policies, tmp_path):
    low, high = gripper.model.actuator_ctrlrange[gripper.actuator_ids].T
    commands = np.repeat((0.5 * (low + high))[None], 20, axis=0)
    write_motions(tmp_path / "two.parquet", gripper, [Motion(name, commands, np.zeros(3)) for name in "ab"])
    (policy,) = read_policies(policies({"name": "p", "source": "two.parquet", "motion": "b"}), gripper)
    given = policy.orders(gripper, starts, 1, 1.0).commands
    assert given.shape[:2] == (len(starts), round(gripper.file.rate_hz))
    np.testing.assert_allclose(given[0, -1], commands[-1])
    with pytest.raises(UsageError, match=r"names no motion of its file\n\s+expected: motion: one of a, b"):
        read_policies(policies({"name": "p", "source": "two.parquet"}), gripper)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([{"name": "p", "source": "graps"}], "'graps' names no policy"),
        ([{"name": "p", "source": "push"}, {"name": "p", "source": "roll"}], "two policies are called p"),
        ([{"name": "p", "source": "push", "noise": 1}], "noise"),
        ([{"name": "p", "source": "push", "variant": 9}], "no variant 9"),
        ([{"name": "p", "source": "lacking.py:act"}], r"imported\n\s+found: ModuleNotFoundError: .*no_such_package"),
        ([{"name": "p", "source": "nowhere.safetensors"}], "nowhere.safetensors does not exist"),
        ([], "policies"),
    ],
)
def test_what_is_no_policy_is_refused(entries, words, gripper, policies, tmp_path):
    (tmp_path / "lacking.py").write_text("import no_such_package\n")
    with pytest.raises(CandataError, match=words):
        read_policies(policies(*entries), gripper)


def test_goals_are_read_with_their_numbers():
    assert parsed_goal("lift:0.05,1") == Goal(lift_m=0.05, held_s=1.0)
    assert parsed_goal("topple").topple
    place = parsed_goal("place:0.1,-0.05").place_m
    assert place is not None
    assert place.tolist() == [0.1, -0.05, 0.0]


@pytest.mark.parametrize("text", ["fly", "lift:high", "lift:-1", "place", "turn:1,2", "topple:1", "lift:nan"])
def test_a_goal_that_means_nothing_is_refused(text):
    with pytest.raises(UsageError):
        parsed_goal(text)


@pytest.mark.parametrize("text", ["lift:20", "place:100,0", "place:0,-50", "turn:30"])
def test_a_goal_in_millimetres_or_degrees_is_refused(text):
    with pytest.raises(UsageError, match="more than can be reached"):
        parsed_goal(text)


def test_a_lift_that_is_held_for_longer_than_is_played_is_refused():
    check_held(parsed_goal("lift:0.02,1.6"), 1.6)
    check_held(parsed_goal("turn"), 0.1)
    with pytest.raises(UsageError, match="hold for longer than what is played"):
        check_held(parsed_goal("lift:0.02,5"), 1.6)
    with pytest.raises(UsageError, match="no length"):
        check_held(None, np.inf)
