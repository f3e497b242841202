"""What a diagnosis says of the time left: ranges in units of its own replay, and a latest end that does not grow."""

from __future__ import annotations

from dataclasses import replace

import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.gap import diagnose
from candata.gap.data.recordings import recordings
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.pace import ANOTHER, ONE, REST, SIGNATURE, Forecast, Pace, Span
from candata.gap.run.streams import Streams
from candata.gap.screening.demand import wanted
from candata.gap.search.outlook import LATER, say_outlook
from candata.schema.manifest import Lineage


@pytest.mark.parametrize(
    ("replay_s", "span", "text"),
    [
        (2.0, Span(10, 20), "step (about 20 to 45 s)"),
        (2.0, Span(50, 100), "step (about 100 s to 3 min)"),
        (2.0, Span(100, 200), "step (about 3 to 7 min)"),
        (2.0, Span(0, 100), "step (at most about 3 min)"),
        (0.1, Span(10, 20), "step"),
        (0.0, Span(10, 20), "step"),
    ],
)
def test_a_step_is_told_with_the_time_it_takes_in_replays(replay_s, span, text):
    told = []
    Pace(told.append, replay_s).say("step", span)
    assert told == [text]


@pytest.fixture
def posed(arm, arm_episodes, tmp_path):
    recs = recordings(arm, arm_episodes(count=12, rows=80))
    problem = _problem(Replayer(arm), recs, Streams(0), tmp_path, lambda stage: None, share=True)
    others = {s.name for _, some in wanted(problem, "first") for s in some} - {"joint_damping", "servo_gain"}
    return replace(problem, ruled_out=frozenset(others))


def test_before_a_search_it_is_said_what_it_takes_and_what_is_not_kept(posed):
    told = []
    pace = Pace(told.append, 10.0)
    some = wanted(posed, "first")
    looks = SIGNATURE * sum(len(part.recs) for part, _ in some) / len(posed.recs)
    say_outlook(replace(posed, pace=pace))
    for part, effects in some:
        part.library.keep(effects)
    say_outlook(replace(posed, pace=pace))
    assert len(posed.recs) > len(some[0][0].recs)
    further = f"; each further cause {pace.range_of(ANOTHER)} more"
    first = pace.range_of(Span(ONE.least + looks, ONE.most + looks + SIGNATURE * LATER))
    assert told == [
        f"searching effects ({first}{further}; {len(some)} effects to simulate first)",
        f"searching effects ({pace.range_of(ONE)}{further})",
    ]


def test_a_problem_knows_how_long_its_replay_took(posed):
    assert posed.pace.replay_s > 0


def test_a_search_tells_what_it_found_and_that_it_goes_on(arm, arm_episodes, planted, tmp_path):
    names = ("joint_dry_friction", "actuation_delay")
    two = (*planted(names[0], frictionloss_Nm=0.3), *planted(names[1], delay_s=0.03))
    create_dataset(tmp_path / "real", "real")
    append(tmp_path / "real", arm_episodes(two, count=8, rows=80), Lineage(operation="test"))
    told = []
    found = diagnose(open_dataset(tmp_path / "real"), arm, only=names, progress=told.append)
    assert {e.name for e in found.report.effects} == set(names)
    first, *rest = [step for step in told if "searching" in step or "comparing" in step or "found" in step]
    assert first.startswith("searching effects")
    # A slow machine adds how long that takes.
    assert rest[0].startswith("comparing what is best so far")
    assert " found, looking for what is beside" in rest[1]
    assert set(rest[1].split(" found,")[0].split(", ")) <= set(names)
    assert told[-1] == "measuring on held-out episodes"


class FakeTime:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def watched():
    """A forecast of replays of 1000 steps, 2 s each, after the first; what it told, and how to go on by replays."""
    clock, told = FakeTime(), []
    forecast = Forecast(told.append, clock)
    forecast.begin()

    def go(replays: float, each_s: float = 2.0) -> None:
        clock.now_s += replays * each_s
        forecast.count(round(1000 * replays))

    go(1)
    return forecast, told, go, clock


def test_before_a_plan_there_is_no_end(watched):
    forecast, told, go, _ = watched
    go(5)
    assert (forecast.ends_s, told, forecast.left, forecast.done) == (None, [], 0.0, 6.0)


def test_the_first_replay_says_how_long_a_plan_takes(watched):
    forecast, told, _, _ = watched
    assert not forecast.plan(50, whole=True)
    assert told == [102.0 + 50 * 2.0]


def test_the_end_comes_nearer_as_steps_take_less_and_never_moves_later_by_itself(watched):
    forecast, told, go, clock = watched
    forecast.plan(50, whole=True)
    go(10, each_s=1.0)
    assert told[-1] == pytest.approx(112.0 + 40 * 12 / 11)
    go(10, each_s=9.0)  # a machine that has become slower
    assert told == sorted(told, reverse=True)
    assert forecast.ends_s == told[-1] < clock.now_s + 30 * 102 / 21


def test_a_plan_that_is_whole_and_shorter_brings_the_end_nearer(watched):
    forecast, told, _, _ = watched
    forecast.plan(50, whole=True)
    assert not forecast.plan(12, whole=True)
    assert told == [202.0, 126.0]


def test_a_part_of_what_was_planned_changes_nothing(watched):
    forecast, told, _, _ = watched
    forecast.plan(50, whole=True)
    assert not forecast.plan(20, whole=False)
    assert told == [202.0]


def test_more_than_was_planned_moves_the_end_and_says_so(watched):
    forecast, told, go, clock = watched
    words = []
    pace = Pace(words.append, 2.0, forecast)
    pace.say("searching", Span(10, 30), after=10.0)
    go(35)
    pace.say("looking again", Span(40, 60))
    pace.say("measuring", Span(1, 12), after=0.0)
    assert words == [
        "searching (about 20 to 65 s)",
        "looking again (about 80 s to 2 min), more than was planned",
        "measuring (about 2 to 29 s)",
    ]
    first, later, last = told
    assert (first, later, last) == (102.0 + 40 * 2, clock.now_s + (60 + REST.most) * 2, clock.now_s + 12 * 2)


def test_an_overdue_end_stays_where_it_was(watched):
    forecast, told, go, clock = watched
    forecast.plan(5, whole=True)
    go(20)
    assert told == [112.0]
    assert (forecast.left, clock.now_s > 112.0) == (0.0, True)


def test_a_diagnosis_tells_an_end_that_moves_later_only_where_it_says_so(arm, arm_episodes, planted, judge):
    told: list[tuple[str, float]] = []
    effects = planted("joint_dry_friction", frictionloss_Nm=0.3)
    judge(
        arm,
        arm_episodes(effects, count=12),
        only=("joint_dry_friction", "servo_gain", "joint_damping"),
        progress=lambda step: told.append((step, 0.0)),
        ends=lambda ends_s: told.append(("", ends_s)),
    )
    assert any(not step for step, _ in told)
    later = [i for i in range(1, len(told)) if not told[i][0] and told[i][1] > max(_ends_before(told, i), default=1e99)]
    assert all(told[i + 1][0].endswith("more than was planned") for i in later)


def _ends_before(told: list[tuple[str, float]], i: int) -> list[float]:
    """The last end that was told before the i-th word."""
    return [ends_s for step, ends_s in told[:i] if not step][-1:]
