"""A spent budget gives what is known by then and names nothing; one that is not spent changes nothing."""

from __future__ import annotations

from itertools import pairwise

import pytest

from candata.errors import UsageError
from candata.gap.replay.budget import Budget, BudgetSpent
from candata.gap.replay.replayer import Replayer
from candata.gap.verdict.interruption import NOT_LOOKED_AT

#: Steps of a diagnosis, by what is known when its budget is spent there.
NOTHING, FLOOR, FIRST_LOOK = "reading", "measuring the floor", "searching effects"
ALL = "measuring on held-out episodes"


class Clock:
    """Process time that stands still until the diagnosis comes to a step, and then is over."""

    def __init__(self, until: str, batches: int = 1) -> None:
        self.until, self.left, self.come = until, batches, False

    def tell(self, step: str) -> None:
        self.come |= step.startswith(self.until)

    def time(self) -> float:
        self.left -= self.come
        return 1e6 if self.come and self.left < 0 else 1.0


@pytest.fixture
def stopped(monkeypatch, arm, arm_episodes, planted, judge):
    """The function that diagnoses an arm with damped joints on a budget that is spent so far into a step."""

    def run(until: str, batches: int = 1, **options):
        clock = Clock(until, batches)
        monkeypatch.setattr("candata.gap.replay.budget.time.process_time", clock.time)
        episodes = arm_episodes(planted("joint_damping", damping_Nms_rad=1.0), count=12)
        return judge(arm, episodes, budget=100.0, progress=clock.tell, **options)

    return run


def test_a_spent_budget_ends_the_next_simulation(arm):
    steps: list[int] = []
    Budget(1e6).watched(Replayer(arm, 1, steps.append)).count(5)
    with pytest.raises(BudgetSpent):
        Budget(1.0, began=-1e9).watched(Replayer(arm, 1, steps.append)).count(7)
    assert steps == [5, 7]


@pytest.mark.parametrize("seconds", [0.0, -3.0, float("nan")])
def test_no_time_at_all_is_refused(seconds):
    with pytest.raises(UsageError, match="above zero"):
        Budget(seconds)


@pytest.mark.parametrize(("step", "named"), [(NOTHING, "reading"), (FLOOR, "measuring the floor")])
def test_before_the_floor_is_measured_nothing_is_compared(stopped, step, named):
    report = stopped(step, batches=0).report
    assert report.verdict == "out_of_budget"
    assert (report.gap, report.effects, report.ranking, report.where) == (None, (), (), ())
    assert report.unknown.words == f"Nothing was compared: the budget was spent at the step {named!r}"
    assert report.data.notes[0] == (
        f"the budget of 100 CPU s was spent at the step {named!r}: give several times as much"
    )
    assert (report.data.episodes.total, report.data.episodes.held_out) == (12, 0)


def test_in_the_first_look_it_says_the_gap_and_which_effects_were_not_looked_at(stopped):
    found = stopped(FIRST_LOOK)
    report = found.report
    assert (report.verdict, report.effects, found.effects.effects) == ("out_of_budget", (), ())
    assert report.gap.before > 1.5
    assert report.gap.closed is None
    assert report.where[0].channel == "joint_position"
    assert report.unknown.acts_on == "joint"
    unseen = [one.name for one in report.ranking if one.reason == NOT_LOOKED_AT]
    seen = [one for one in report.ranking if one.reason is None]
    assert unseen
    assert (
        f"not looked at were {len(unseen)} of {len(report.ranking)} effects, all of its rivals" in report.unknown.words
    )
    assert all(one.held_out_gain >= later.held_out_gain for one, later in pairwise(seen))
    assert report.data.notes[0].startswith("the budget of 100 CPU s was spent at the step 'searching effects'; ")
    assert "a whole search takes about" in report.data.notes[0]


def test_what_was_found_by_then_is_nearest_and_not_named(stopped):
    report = stopped(ALL, batches=0, only=("joint_damping", "servo_gain")).report
    assert (report.verdict, report.effects) == ("out_of_budget", ())
    assert report.ranking[0].name == "joint_damping"
    assert report.ranking[0].held_out_gain > 1
    assert report.unknown.words.startswith("Whether joint_damping, nearest so far (")
    assert " floors on held-out episodes), is the cause: not looked at were all of its rivals" in report.unknown.words


def test_a_search_within_its_budget_is_the_same_search(arm, arm_episodes, planted, judge):
    episodes = arm_episodes(planted("joint_damping", damping_Nms_rad=1.0))
    only = ("joint_damping", "servo_gain")
    free, held = (judge(arm, episodes, only=only, budget=budget).report for budget in (None, 1e6))
    assert free.verdict == "explained"
    assert free.model_dump_json() == held.model_dump_json()


def test_a_budget_that_is_spent_on_tosses_says_what_they_show(cube, played, judge, planted, monkeypatch):
    clock = Clock(FIRST_LOOK, 0)
    monkeypatch.setattr("candata.gap.replay.budget.time.process_time", clock.time)
    episodes = played(cube, planted("friction_cone", cone="elliptic"), duration_s=0.7)
    report = judge(cube, episodes, budget=100.0, progress=clock.tell).report
    assert report.verdict == "out_of_budget"
    assert report.gap.before > 1
    assert {one.reason for one in report.ranking} == {NOT_LOOKED_AT}
