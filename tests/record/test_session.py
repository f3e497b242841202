"""Marks become episodes; what fits no episode is kept as it was typed, with a note."""

from __future__ import annotations

import pytest

from candata.record.session import Session, SessionPlan, Touch, due_mark, replay


def typed(keys: str) -> Session:
    """Type a key each second; keys that make no mark are passed over."""
    session = Session()
    for second, key in enumerate(keys):
        mark = session.typed(key, second * 10**9)
        if mark is not None:
            session.mark(mark, second * 10**9, "key", key)
    return session


def test_the_space_bar_begins_and_ends_and_a_judgement_counts_for_the_newest_episode():
    session = typed(" s d  l")
    assert [(e.number, e.begin_ns, e.end_ns, e.outcome) for e in session.episodes] == [
        (1, 0, 2 * 10**9, "drop"),
        (2, 4 * 10**9, 5 * 10**9, "slip"),
    ]
    assert [mark.note for mark in session.marks if mark.note] == ["episode 1 was success, now drop"]


def test_a_mark_that_fits_no_episode_is_kept_and_guesses_nothing():
    session = Session()
    kept = [session.mark(mark, k) for k, mark in enumerate(("success", "end", "begin", "begin", "end", "end"))]
    assert [mark.episode for mark in kept] == [None, None, 1, None, 1, None]
    assert all(mark.note for mark in kept if mark.episode is None)
    assert [(e.begin_ns, e.end_ns, e.outcome) for e in session.episodes] == [(2, 4, None)]
    assert [mark.mark for mark in session.marks] == ["success", "end", "begin", "begin", "end", "end"]


def test_a_discarded_episode_keeps_its_number_and_an_unknown_key_makes_no_mark():
    session = typed(" q xz ")
    assert [(e.number, e.discarded) for e in session.episodes] == [(1, True), (2, False)]
    assert session.open_episode == session.episodes[1]
    assert len(session.marks) == 4


def test_marks_lead_to_the_same_session_again():
    session = typed("s  l x d s ")
    again = replay(session.marks)
    assert again.marks == session.marks
    assert again.episodes == session.episodes


def test_lost_marks_give_no_episode_another_number():
    marks = typed(" s  d  l ").marks
    assert [mark.mark for mark in marks] == ["begin", "success", "end", "begin", "drop", "end", "begin", "slip", "end"]
    first, second, third = typed(" s  d  l ").episodes
    assert replay(marks[3:]).episodes == [second, third]
    assert replay(marks[:1] + marks[4:]).episodes == [first.model_copy(update={"end_ns": None, "outcome": None}), third]


def played(plan: SessionPlan, touching: list[bool]) -> list[tuple[int, int | None]]:
    """Follow a plan in steps of 1 s over what the fingertips do; return begin and end of each episode [s]."""
    session, touch = Session(), Touch()
    for second, is_touching in enumerate(touching):
        touch = touch.seen(second * 10**9, is_touching)
        due = due_mark(plan, session, second * 10**9, 0, touch)
        if due is not None:
            session.mark(*due, "schedule")
    assert plan.is_done(session) == (len(session.episodes) == plan.episodes and session.open_episode is None)
    return [(e.begin_ns // 10**9, None if e.end_ns is None else e.end_ns // 10**9) for e in session.episodes]


def test_a_schedule_rests_before_each_episode_and_ends():
    assert played(SessionPlan(2, 3.0, 2.0), [False] * 20) == [(2, 5), (7, 10)]


def test_a_schedule_that_is_looked_at_late_does_not_run_late():
    session, plan = Session(), SessionPlan(3, 1.2, 0.7)
    for second in range(20):  # nobody looks more often than once a second
        if due := due_mark(plan, session, second * 10**9, 0, Touch()):
            session.mark(*due, "schedule")
    assert [e.begin_ns for e in session.episodes] == [700_000_000, 2_600_000_000, 4_500_000_000]
    assert {e.end_ns - e.begin_ns for e in session.episodes} == {1_200_000_000}


@pytest.mark.parametrize("begins_in_touch", [False, True])
def test_an_episode_by_contact_begins_after_the_hand_was_free_and_ends_when_it_is_again(begins_in_touch):
    touching = [begins_in_touch, False, True, True, False, True, False, False, False, True]
    assert played(SessionPlan(gap_s=2.0, on_contact=True), touching) == [(2, 7), (9, None)]
