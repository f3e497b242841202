"""Joints that come early: a clock, a servo or commands that were logged late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.effects import setting
from candata.gap.mismatch import mismatch
from candata.gap.recordings import recordings
from candata.gap.replay import Replayer

MOTIONS = ("grasp_lift_shake", "free_sweep", "roll")


@pytest.fixture(scope="module")
def shifts(hand, played):
    """The function that tells whether motions of 3.2 s in a world are said to be shifted, and surely so."""

    def make(effects=(), late: int = 0):
        recs = recordings(hand, played(hand, effects, count=3, duration_s=3.2, policies=MOTIONS))
        before = np.maximum(np.arange(recs.commands.shape[1]) - late, 0)
        recs = replace(recs, commands=recs.commands[:, before])
        return [f.definite for f in mismatch(Replayer(hand), recs) if f.kind == "shifted_commands"]

    return make


@pytest.mark.parametrize("ppm", [-5.7e3, -1.1e4])
def test_a_slow_clock_is_never_surely_a_shift(hand, shifts, ppm):
    assert True not in shifts((setting("clock_drift", np.array([ppm]), hand),))


@pytest.mark.parametrize(("name", "value"), [("servo_damping", 0.78), ("servo_gain", 1.4)])
def test_a_faster_servo_is_never_surely_a_shift(hand, shifts, name, value):
    assert True not in shifts((setting(name, np.array([value]), hand),))


@pytest.mark.parametrize("late", [1, 2])
def test_commands_that_are_logged_late_are_surely_shifted(shifts, late):
    assert shifts(late=late) == [True]
