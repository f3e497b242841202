"""What a diagnosis says of the time left: ranges in units of its own replay, nothing where there is nothing to say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.gap import diagnose
from candata.gap.diagnosis import _problem
from candata.gap.outlook import LATER, say_outlook
from candata.gap.pace import ANOTHER, ONE, SIGNATURE, Pace, Span
from candata.gap.recordings import recordings
from candata.gap.replay import Replayer
from candata.gap.wanted import wanted
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
    problem = _problem(Replayer(arm), recs, np.random.default_rng(0), tmp_path, lambda stage: None, share=True)
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
    assert rest[1].split()[0] in names
    assert told[-1] == "measuring on held-out episodes"
