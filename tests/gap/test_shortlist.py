"""The shortlist: a few episodes stand for all, the cause is on it, and what is not is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate, candidates
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import CrossFit
from candata.gap.fit.response import Plane
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening import look as staging
from candata.gap.screening import shortlist
from candata.gap.screening.episodes import FEW, brief, few, looked_into
from candata.gap.screening.look import typical
from candata.gap.screening.shortlist import FITTED, MOST, _gains, reconsidered, screened
from candata.gap.screening.signature_screen import respond
from candata.gap.search.attribution import attribute


def test_every_task_is_among_the_few():
    tasks = ["squeeze"] * 9 + ["roll"] * 9 + ["push"]
    chosen = few(tasks)
    assert len(chosen) == FEW
    assert {tasks[i] for i in chosen} == {"squeeze", "roll", "push"}
    many = [f"task {i}" for i in range(FEW + 3)] * 2
    assert len({many[i] for i in few(many)}) == FEW + 3
    assert np.array_equal(few(many), few(many))
    # Where nothing is shared, those of each task that leave most, turn by turn.
    assert few(tasks, np.arange(19.0)).tolist() == [7, 8, 15, 16, 17, 18]


@pytest.fixture(scope="module")
def posed(arm, arm_episodes, planted):
    """The problem that 12 recordings of an arm with damped joints pose."""
    recs = recordings(arm, arm_episodes(planted("joint_damping", damping_Nms_rad=0.3), count=12))
    return _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)


def test_the_few_are_the_problem_of_those_episodes(posed):
    part, index = brief(posed)
    assert len(index) == FEW
    assert np.array_equal(part.nominal, posed.nominal[index])
    assert part.recs.ids == tuple(posed.recs.ids[i] for i in index)
    assert brief(part)[0] is part


def test_where_all_is_simulated_the_episodes_that_leave_most_come_first(posed):
    left = np.arange(len(posed.recs), dtype=float)
    here = np.sqrt(left).astype(np.float32)[:, None] * np.ones_like(posed.nominal)
    alike = looked_into(replace(posed, recs=replace(posed.recs, tasks=("a",) * len(left))), here)
    assert alike.simulated
    assert brief(alike)[1].tolist() == [6, 7, 8, 9, 10, 11]
    mixed = looked_into(replace(posed, recs=replace(posed.recs, tasks=tuple("abcabcabcccc"))), here)
    part, index = brief(mixed)
    assert index.tolist() == [4, 6, 7, 9, 10, 11], "at most three of a task"
    assert brief(part)[0] is part


def test_the_cause_is_on_the_list_and_the_others_are_named(posed, arm):
    base, _ = typical(posed)
    found = candidates(arm, list(posed.recs.readings))
    seen = screened(posed, found, base)
    labels = {c.label for c, _ in seen.responses}
    assert "joint_damping" in labels
    assert len(labels) <= MOST + FITTED
    assert {c.label for c in found} <= labels | set(seen.faint) | set(seen.dead)
    assert seen.tried > len(seen.responses)
    assert all(len(r.read(c.neutral)) == len(posed.recs) for c, r in seen.responses)


def test_a_second_look_leaves_out_only_what_closes_next_to_nothing_where_it_is_fitted(posed, arm, monkeypatch):
    base, _ = typical(posed)
    found = candidates(arm, list(posed.recs.readings))
    part, index = brief(posed)
    first = screened(posed, found, base)
    before = {c.label for c, _ in first.responses if c.element is None}
    fitted = {c.label: shortlist.fitted(part, r, base[index])[0] for c, r in first.rough}
    left = float((base[index] - 1).mean())
    size = []
    for share in (-np.inf, 0.1, np.inf):
        monkeypatch.setattr("candata.gap.screening.shortlist.WORTH", share)
        seen = reconsidered(posed, first, base)
        labels = {c.label for c, _ in seen.responses}
        assert labels == {name for name, gain in fitted.items() if gain > share * left} | before
        assert {c.label for c in found} == {n for n in labels if " " not in n} | set(seen.faint) | set(seen.dead)
        assert all(len(r.read(c.neutral)) == len(posed.recs) for c, r in seen.responses)
        size.append(len(labels))
    assert size[0] > size[1] > size[2]


def test_gains_on_a_few_episodes_are_held_out(posed, arm):
    """What has nothing to do with it keeps nothing there of what it gains where it is fitted to the same episodes."""
    part, index = brief(posed)
    base = posed.score.loss(posed.nominal)[index]
    responses, _ = respond(part, part.nominal, candidates(arm, list(posed.recs.readings)))
    gains = _gains(part, responses, base)
    assert "joint_damping" in [c.name for _, c in gains[:2]]  # a servo that damps does much the same
    fitted = {c.label: shortlist.fitted(part, r, base)[0] for c, r in responses}
    idle = next(pair for pair in reversed(gains) if fitted[pair[1].label] > 0)
    assert idle[0] < fitted[idle[1].label] / 10


def test_a_vector_gains_what_it_does_where_it_was_simulated(posed, arm):
    """Of so few episodes, fitted without each, slopes may lead anywhere; what was simulated stands."""
    part, _ = brief(posed)
    c, here = candidate("joint_offset", arm), part.nominal
    better, wild = 0.5 * here, np.stack([here[::-1], here[:, ::-1]]) * np.float32(50)
    plane = Plane(c.low, c.high, c.neutral + 0.01, better, wild)
    base = part.score.loss(here)
    there = float((base - part.score.loss(better)).mean())
    fitted = _gains(part, [(c, plane)], base)[0][0]
    assert fitted < there
    assert _gains(replace(part, simulated=True), [(c, plane)], base)[0][0] == pytest.approx(there)


def test_what_gains_most_where_it_is_fitted_comes_along(posed, arm, monkeypatch):
    """Held out, a vector may fail for want of episodes alone."""
    base, _ = typical(posed)
    found = candidates(arm, list(posed.recs.readings))
    part, index = brief(posed)
    responses, _ = respond(part, part.nominal, found)
    fitted = {c.label: shortlist.fitted(part, r, base[index])[0] for c, r in responses}
    monkeypatch.setattr("candata.gap.screening.shortlist.LEAST", 1)
    monkeypatch.setattr("candata.gap.screening.shortlist.MOST", 1)
    first = sorted(fitted, key=lambda name: -fitted[name])[:FITTED]
    for share, wanted in ((0.0, first), (0.999, first[:1])):
        monkeypatch.setattr("candata.gap.screening.shortlist.ALONE", share)
        labels = {c.label for c, _ in screened(posed, found, base).responses}
        assert set(wanted) <= labels
        assert len(labels) <= 1 + len(wanted)


def test_before_a_cause_is_called_unknown_more_is_looked_at(posed, monkeypatch):
    def blind(problem, found, base):
        seen = screened(problem, found, base)
        poor = [(c, r) for c, r in seen.responses if c.name == "object_mass"]
        return replace(seen, responses=poor, faint=("joint_damping",))

    monkeypatch.setattr(staging, "screened", blind)
    found = attribute(posed)
    assert found.chosen is not None
    assert found.chosen.labels[0] == "joint_damping"


@pytest.mark.parametrize(("promised", "near"), [(0.035, ["servo_damping"]), (0.07, []), (-0.01, ["servo_damping"])])
def test_a_rival_is_compared_with_what_the_best_one_promised(posed, monkeypatch, promised, near):
    """Fitted on the recording the best one gains 0.07; a rival's signatures promise 0.02."""
    scene = posed.replayer.scene
    best, rival = candidate("joint_damping", scene), candidate("servo_damping", scene)
    count = len(posed.recs)
    fitted = Fit(((best, best.neutral),), None, CrossFit(np.full(count, 0.07), np.zeros(count), np.zeros((0, 0))))
    monkeypatch.setattr(shortlist, "respond", lambda part, here, found, held=(): (found, []))
    monkeypatch.setattr(shortlist, "_gains", lambda part, found, base: [(promised, best), (0.02, rival)])
    found = shortlist.rivals(posed, posed.nominal, [rival], np.ones(count), fitted)
    assert [c.label for c in found] == near
