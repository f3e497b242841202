"""The shortlist: a few episodes stand for all, the cause is on it, and what is not is said."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.attribute import _base
from candata.gap.candidates import candidates
from candata.gap.diagnosis import _problem
from candata.gap.recordings import recordings
from candata.gap.replay import Replayer
from candata.gap.shortlist import FEW, MOST, brief, few, screened


def test_every_task_is_among_the_few():
    tasks = ["squeeze"] * 9 + ["roll"] * 9 + ["push"]
    chosen = few(tasks)
    assert len(chosen) == FEW
    assert {tasks[i] for i in chosen} == {"squeeze", "roll", "push"}
    many = [f"task {i}" for i in range(FEW + 3)] * 2
    assert len({many[i] for i in few(many)}) == FEW + 3
    assert np.array_equal(few(many), few(many))


@pytest.fixture(scope="module")
def posed(arm, arm_episodes, planted):
    """The problem that 12 recordings of an arm with damped joints pose."""
    recs = recordings(arm, arm_episodes(planted("joint_damping", damping_Nms_rad=0.3), count=12))
    return _problem(Replayer(arm), recs, np.random.default_rng(0), None, lambda stage: None)


def test_the_few_are_the_problem_of_those_episodes(posed):
    part, index = brief(posed)
    assert len(index) == FEW
    assert np.array_equal(part.nominal, posed.nominal[index])
    assert part.recs.ids == tuple(posed.recs.ids[i] for i in index)
    assert brief(part)[0] is part


def test_the_cause_is_on_the_list_and_the_others_are_named(posed, arm):
    base, _ = _base(posed, posed.nominal, ())
    found = candidates(arm, list(posed.recs.readings))
    seen = screened(posed, posed.nominal, found, (), base)
    labels = {c.label for c, _ in seen.responses}
    assert "joint_damping" in labels
    assert len(labels) <= MOST
    assert {c.label for c in found} <= labels | set(seen.faint) | set(seen.dead)
    assert seen.tried > len(seen.responses)
    assert all(len(r.read(c.neutral)) == len(posed.recs) for c, r in seen.responses)
