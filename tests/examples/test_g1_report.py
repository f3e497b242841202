"""The table of joints says what answers, what is described badly, and what tells nothing."""

from __future__ import annotations

from types import SimpleNamespace

import pytest


def response(joint: str, **change: object) -> SimpleNamespace:
    values = {"lag_s": 0.2, "lag_low_s": 0.18, "lag_high_s": 0.23, "delay_s": 0.1, "bandwidth_hz": 1.2, "gain": 0.98}
    rest = {"r2": 0.99, "motion": 0.15, "why_not": ""}
    return SimpleNamespace(joint=joint, identifiable=not change.get("why_not"), **{**values, **rest, **change})


@pytest.fixture(scope="module")
def table(loaded):
    return loaded("g1_inspire_pick/report.py").table


def test_a_joint_that_answers_has_its_numbers_in_ms(table):
    lines = table([response("Elbow")], 30.0)
    (line,) = [text for text in lines if text.startswith("Elbow")]
    assert line.split() == ["Elbow", "0.150", "200", "180", "to", "230", "6.0", "100", "1.20", "0.98", "0.990"]


def test_a_poor_fit_is_marked_and_a_good_one_is_not(table):
    lines = table([response("Elbow"), response("Thumb", r2=0.78, gain=0.59)], 30.0)
    assert [text.split()[0] for text in lines if "poor" in text] == ["Thumb"]


def test_still_joints_have_no_numbers_but_their_reason(table):
    lines = table([response("Elbow"), response("Wrist", why_not="its command hardly moves", motion=0.004)], 30.0)
    at = next(i for i, text in enumerate(lines) if text.startswith("not identifiable"))
    assert lines[at] == "not identifiable, its command hardly moves (0.004 at most):"
    assert lines[at + 1].strip() == "Wrist"
    assert not any(text.startswith("Wrist") for text in lines)


def test_a_robot_that_stands_still_has_no_table(table):
    lines = table([response("Wrist", why_not="its command hardly moves", motion=0.004)], 30.0)
    assert lines[0].startswith("0 of 1")
    assert not any("lag" in text for text in lines)
