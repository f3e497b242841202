"""End to end on tosses: no actuators, no hand, a discrete cause."""

from __future__ import annotations

import pytest

from candata.gap import preparation

COUNT, SECONDS = 12, 0.8


@pytest.fixture(scope="module")
def elliptic(cube, played, planted, judge):
    return judge(cube, played(cube, planted("friction_cone", cone="elliptic"), COUNT, SECONDS, seed=5))


def test_a_planted_cone_is_named(elliptic):
    report = elliptic.report
    assert (report.verdict, [e.name for e in report.effects]) == ("explained", ["friction_cone"])
    cone = report.effects[0].parameters["cone"]
    assert (cone.value, cone.low, cone.high) == ("elliptic", None, None)
    assert report.gap.closed >= 0.8
    assert elliptic.effects.effects[0].parameters == {"cone": "elliptic"}
    assert elliptic.replays > 10, "each of the effects was simulated on the recordings"


def test_a_toss_has_the_phases_of_a_toss(elliptic):
    assert elliptic.evidence.heat.phases == ("flight", "impact", "rest")
    assert elliptic.report.data.channels == ("object_pose",)
    # The cone acts on contact: free flight cannot show it.
    assert elliptic.report.where
    assert all(s.phase != "flight" for s in elliptic.report.where)


def test_errors_are_told_in_physical_units(elliptic):
    measures = elliptic.report.measures
    assert set(measures) == {"object_position_m", "object_rotation_deg"}
    for errors in measures.values():
        assert errors["after"] < errors["before"]


def test_with_the_pyramidal_cone_nothing_is_named(cube, played, judge):
    report = judge(cube, played(cube, count=COUNT, duration_s=SECONDS, seed=5)).report
    assert (report.verdict, report.effects) == ("no_gap", ())


def test_more_tosses_are_searched_than_episodes_of_a_hand(cube, played, judge, monkeypatch):
    assert preparation.TOSSES > preparation.SEARCHED
    monkeypatch.setattr(preparation, "SEARCHED", 2)
    monkeypatch.setattr(preparation, "TOSSES", 8)
    monkeypatch.setattr(preparation, "UNTOUCHED", 4)
    report = judge(cube, played(cube, count=COUNT, duration_s=0.4, seed=5)).report
    assert report.data.notes == ("effects searched on 8 episodes, measured on the other 4",)


@pytest.mark.slow
def test_tosses_of_the_nominal_world_leave_nothing_unknown(cube, played, judge):
    report = judge(cube, played(cube, count=COUNT, duration_s=SECONDS, seed=6)).report
    assert (report.verdict, report.effects) == ("no_gap", ())
