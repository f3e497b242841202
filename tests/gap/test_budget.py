"""A budget too small is a clear message, never a verdict of a search cut short."""

from __future__ import annotations

import pytest

from candata.errors import UsageError
from candata.gap.budget import LEAST_REPLAYS, Budget
from candata.gap.replay import Replayer


def test_what_cannot_be_done_is_refused_by_the_first_replay():
    with pytest.raises(UsageError) as caught:
        Budget(10.0).check(1.0, 16)
    assert caught.value.expected.startswith(f"about {LEAST_REPLAYS} CPU s or more (16 episodes, 1 s for each of")
    assert caught.value.found == "10 CPU s"
    assert "--only" in caught.value.fix
    Budget(10.0).check(0.1, 16)


def test_a_spent_budget_stops_the_next_simulation(arm):
    steps: list[int] = []
    Budget(1e6).watched(Replayer(arm, 1, steps.append)).count(5)
    with pytest.raises(UsageError, match="the budget is spent"):
        Budget(1.0, began=-1e9).watched(Replayer(arm, 1, steps.append)).count(7)
    assert steps == [5, 7]


@pytest.mark.parametrize("seconds", [0.0, -3.0, float("nan")])
def test_no_time_at_all_is_refused(seconds):
    with pytest.raises(UsageError, match="above zero"):
        Budget(seconds)


def test_a_diagnosis_on_a_budget_too_small_names_nothing(arm, arm_episodes, planted, judge):
    stages: list[str] = []
    episodes = arm_episodes(planted("joint_damping", damping_Nms_rad=1.0))
    with pytest.raises(UsageError, match="the budget is"):
        judge(arm, episodes, budget=0.3, progress=stages.append)
    assert "measuring on held-out episodes" not in stages
