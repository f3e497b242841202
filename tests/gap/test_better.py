"""A name that leaves much open gives way where a described force closes clearly more by itself."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.verdict import conclusion, unknown_cause
from candata.schema.report import Gap


@pytest.fixture
def found(monkeypatch):
    """The function that asks whether a force that closes a share unseats what closes another."""

    def ask(closed: float, closable: float | None, before: float = 3.0):
        seen = []

        def described(force, world, where, nearest):
            seen.append((force, world, nearest))
            return SimpleNamespace(unknown=SimpleNamespace(closable=closable))

        monkeypatch.setattr(unknown_cause, "described", described)
        size = Gap(before=before, after=before - (before - 1) * closed, closed=closed)
        force = None if closable is None else "a force"
        return unknown_cause.unseating(lambda: force, size, (), "joint_offset ring1"), seen

    return ask


@pytest.mark.parametrize(
    ("closed", "closable", "unseated"),
    [
        (0.37, 0.98, True),
        (0.37, 0.46, False),  # hardly more, with more freedom
        (0.37, None, False),  # no force stands out
        (0.55, 0.9, True),
        (0.81, 0.98, True),  # much is left, in floors and of the gap
        (0.81, 0.9, False),
    ],
)
def test_what_closes_clearly_more_unseats(found, closed, closable, unseated):
    assert (found(closed, closable)[0] is not None) is unseated


def test_it_is_judged_by_itself(found):
    _, seen = found(0.37, 0.98)
    assert seen == [("a force", (), "joint_offset ring1")]


def test_what_explains_is_not_questioned(found):
    assert found(0.9, 1.0) == (None, [])


@pytest.mark.parametrize("closed", [0.81, 0.6])
def test_nor_is_what_leaves_little_of_a_small_gap(found, closed):
    assert found(closed, 1.0, before=1.2) == (None, [])


@pytest.mark.parametrize(
    ("word", "asked"),
    [
        ("explained", True),
        ("partly_explained", True),
        ("ambiguous", True),
        ("no_gap", False),
        ("unknown_effect", False),
    ],
)
def test_whatever_would_be_named_or_left_tied_may_be_unseated(monkeypatch, word, asked):
    monkeypatch.setattr(conclusion, "unseating", lambda force, size, where, nearest: nearest)
    monkeypatch.setattr(conclusion, "judged_problem", lambda f: None)
    found = SimpleNamespace(
        first=SimpleNamespace(fits=(SimpleNamespace(labels=("armature",)),)), force=None, chosen=None, doubt=None
    )
    some = conclusion._unseated(SimpleNamespace(attribution=found), word, Gap(before=3.0, after=2.0), ())
    assert some == ("armature" if asked else None)


def test_a_force_that_ended_the_search_unseats_what_was_found_until_then(monkeypatch):
    monkeypatch.setattr(conclusion, "unseating", lambda *a: pytest.fail("it is played again"))
    monkeypatch.setattr(conclusion, "described", lambda force, world, where, nearest: (force, nearest))
    found = SimpleNamespace(first=SimpleNamespace(fits=(SimpleNamespace(labels=("armature",)),)), force="a pull")
    some = conclusion._unseated(SimpleNamespace(attribution=found), "explained", Gap(before=3.0, after=1.2), ())
    assert some == ("a pull", "armature")


@pytest.fixture
def alias(monkeypatch):
    """The function that asks whether a force that leaves so much of twelve episodes outdoes one name alone."""

    def ask(left: float, closed: float, force: float, unsure: float = 0.001, place: str = "object"):
        own = np.full(12, 1 + left)
        after = 1 + force + unsure * np.resize([1.0, -1.0], 12)
        best = SimpleNamespace(suspects=[SimpleNamespace(place=place)], size=after)
        seen = []
        monkeypatch.setattr(unknown_cause, "described", lambda found, *rest: "a wind")
        score = SimpleNamespace(take=lambda which: SimpleNamespace(size=lambda z: own))
        problem = SimpleNamespace(score=score, residuals=lambda worlds: [own])
        gap = Gap(before=1 + left / (1 - closed), after=1 + left, closed=closed)

        def mended():
            seen.append(True)
            return SimpleNamespace(best=best, which=np.arange(12))

        return unknown_cause.outdoing(problem, mended, gap, (), (), "gravity_tilt"), bool(seen)

    return ask


@pytest.mark.parametrize(
    ("how", "outdone"),
    [
        ({"left": 0.06, "closed": 0.83, "force": 0.0}, True),
        ({"left": 0.06, "closed": 0.83, "force": 0.06}, True),
        ({"left": 0.06, "closed": 0.83, "force": 0.08}, False),  # surely worse
        ({"left": 0.06, "closed": 0.83, "force": 0.08, "unsure": 0.1}, True),  # by less than a standard error
        ({"left": 0.06, "closed": 0.83, "force": 0.1, "unsure": 0.3}, False),  # that, but half as much again
        ({"left": 0.06, "closed": 0.83, "force": 0.0, "place": "fingertip"}, False),
    ],
)
def test_a_force_outdoes_names_that_leave_much_where_it_leaves_no_more_as_far_as_can_be_told(alias, how, outdone):
    assert alias(**how) == ("a wind" if outdone else None, True)


@pytest.mark.parametrize("how", [{"left": 0.02, "closed": 0.83}, {"left": 0.06, "closed": 0.97}])
def test_what_leaves_as_little_as_right_names_do_is_not_asked_about(alias, how):
    assert alias(**how, force=0.0) == (None, False)


@pytest.mark.parametrize(("toss", "asked"), [(False, True), (True, False)])
@pytest.mark.parametrize("names", [1, 2])
def test_several_names_may_be_outdone_as_one_may_but_not_those_of_tosses(monkeypatch, names, toss, asked):
    """A wind was named as a leaning table and a mass centre, that made up for the rest."""
    monkeypatch.setattr(conclusion, "unseating", lambda *a: None)
    monkeypatch.setattr(conclusion, "outdoing", lambda *a: "a wind")
    monkeypatch.setattr(conclusion, "judged_problem", lambda f: None)
    monkeypatch.setattr(conclusion, "is_toss", lambda scene: toss)
    chosen = SimpleNamespace(members=("one",) * names)
    first = SimpleNamespace(fits=(SimpleNamespace(labels=("gravity_tilt",)),))
    some = SimpleNamespace(
        attribution=SimpleNamespace(first=first, force=None, chosen=chosen, doubt=None),
        problem=SimpleNamespace(setting=lambda members: ()),
        scene=None,
    )
    found = conclusion._unseated(some, "explained", Gap(before=1.4, after=1.06, closed=0.85), ())
    assert found == ("a wind" if asked else None)


@pytest.mark.parametrize("close", [0.65, 0.64])
def test_a_force_is_played_once_in_the_nominal_world_for_both_questions_if_it_may_close_enough(monkeypatch, close):
    """It must close the 0.65 that what is named closes."""
    played = []
    doubt = SimpleNamespace(may_close=lambda share: close >= share)
    monkeypatch.setattr(conclusion, "mended", lambda *a: played.append(a))
    monkeypatch.setattr(conclusion, "judged_problem", lambda f: "in the named world's floors")
    monkeypatch.setattr(conclusion, "is_toss", lambda scene: False)
    first = SimpleNamespace(fits=(SimpleNamespace(labels=("gravity_tilt",)),))
    some = SimpleNamespace(
        attribution=SimpleNamespace(
            first=first, force=None, chosen=SimpleNamespace(members=("one", "other")), doubt=doubt
        ),
        problem=SimpleNamespace(setting=lambda members: ()),
        scene=None,
    )
    named = Gap(before=3.0, after=1.7, closed=0.65)
    assert conclusion._unseated(some, "explained", named, ()) is None
    assert played == [("in the named world's floors", ())][: 1 if close >= 0.65 else 0]


def test_of_an_unknown_cause_the_force_is_described_that_the_search_has_played(monkeypatch):
    monkeypatch.setattr(conclusion, "describe", lambda *a: pytest.fail("it is played again"))
    monkeypatch.setattr(conclusion, "described", lambda force, world, where, nearest: (force, world, nearest))
    first = SimpleNamespace(fits=(SimpleNamespace(labels=("armature",)),))
    for force, said in (("a pull", ("a pull", (), "armature")), (None, None)):
        doubt = SimpleNamespace(lone=SimpleNamespace(of_all=force))
        some = SimpleNamespace(attribution=SimpleNamespace(first=first, doubt=doubt))
        assert conclusion._rest(some, "unknown_effect", (), ()) == said
