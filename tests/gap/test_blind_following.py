"""Ambiguous cases followed up: what was proposed is recorded in the hidden world, once, and counted in the table."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.errors import DataError
from candata.gap.blind import follow_up
from candata.gap.blind.cases import CASES, hidden_world, make_cases, read_cases
from candata.gap.blind.labels import open_labels, seal_labels
from candata.gap.blind.outcomes import Outcome
from candata.gap.blind.runs import Place
from candata.gap.blind.scores import score_run
from candata.gap.verdict.proposal import PLAYED
from candata.policies import Motion
from candata.scenes import load_scene
from candata.schema.bench import CaseResult
from candata.schema.report import DiagnosisData, EpisodeCount, Estimate, NamedEffect, NextMotion, Report
from candata.simulate.episodes import EpisodeJob
from tests.gap.conftest import ARM, ROLES

SMALL = {"seed": 3, "episodes": 2, "duration_s": 0.6}
#: A jump of both joints and back.
JUMP = Motion("jump", np.repeat([[0.0, 0.0], [1.0, -1.0], [0.0, 0.0]], 20, axis=0), np.zeros(3))


def said(verdict: str, named: str | None = None) -> Report:
    """A report of a tie, or one that names an effect."""
    data = DiagnosisData(dataset="case", episodes=EpisodeCount(total=2, folds=0, held_out=0))
    if verdict == "ambiguous":
        words = NextMotion(name="jump", file="motion.parquet")
        return Report(verdict=verdict, ambiguous_class=("a", "b"), next_motion=words, data=data)
    value = {"damping_Nms_rad": Estimate(value=0.4)}
    effects = (NamedEffect(name=named, parameters=value, share=1.0, support=0.9),) if named else ()
    return Report(verdict=verdict, effects=effects, data=data)


@pytest.fixture
def run(tmp_path):
    """Two sealed cases of the damped arm: where they lie, and their labels."""
    (tmp_path / "arm.xml").write_text(ARM)
    scene = tmp_path / "scene.yaml"
    scene.write_text(ROLES)
    sealed = seal_labels(tmp_path, load_scene(scene), {"one": 2}, only=("joint_damping",), salt="ab" * 32, **SMALL)
    make_cases(tmp_path, str(scene), sealed, **SMALL)
    cases = read_cases(tmp_path / CASES)
    places = [Place(p, str(scene), c.sealed) for p, c in cases.items()]
    return SimpleNamespace(folder=tmp_path, places=places, labels=open_labels(cases, sealed))


@pytest.fixture
def asked(monkeypatch):
    """Datasets that were diagnosed: a tie at first, the true effect once a motion was recorded beside."""
    seen = []

    def diagnosed(dataset, scene, **_):
        seen.append(list(dataset))
        more = len(dataset) > SMALL["episodes"]
        report = said("explained", "joint_damping") if more else said("ambiguous")
        return SimpleNamespace(report=report, motion=() if more else (JUMP,))

    monkeypatch.setattr(follow_up, "diagnose", diagnosed)
    return seen


def results(run, *reports):
    return [
        CaseResult(case=p.folder.name, sealed=p.sealed, cpu_s=1.0, cold=False, report=r)
        for p, r in zip(run.places, reports, strict=True)
    ]


def test_what_was_proposed_is_recorded_in_the_hidden_world_beside_the_rest(run, asked):
    first = results(run, said("ambiguous"), said("explained", "joint_damping"))
    found = follow_up.follow_up(run.folder, run.places, first, run.labels)
    assert list(found) == ["case-0001"], "only what was ambiguous"
    assert found["case-0001"].report.effects[0].name == "joint_damping"
    before, both = asked
    assert [e.meta.id for e in both[: len(before)]] == [e.meta.id for e in before]
    played = both[len(before) :]
    assert len(played) == PLAYED
    for e in played:
        assert np.allclose(e["action"], JUMP.commands)
        assert not e.meta.effects, "the cause stays hidden"
    assert np.ptp([e["joint_position"][30] for e in played], axis=0).max() > 0, "noise of its own"
    # The same motion in the nominal world goes elsewhere.
    plain = run.labels["case-0001"].model_copy(update={"effects": ()})
    plans = [EpisodeJob("nominal", 9, "jump", 3, motion=JUMP)]
    (nominal,) = hidden_world(load_scene(run.places[0].scene), plain, plans)
    assert np.abs(played[0]["joint_position"] - nominal["joint_position"]).max() > 0.02


def test_what_stands_is_not_recorded_again(run, asked):
    first = results(run, said("ambiguous"), said("ambiguous"))
    told = []
    found = follow_up.follow_up(run.folder, run.places, first, run.labels, told=told.append)
    assert (len(asked), told) == (4, [1, 1])
    assert follow_up.follow_up(run.folder, run.places, first, run.labels) == found
    assert len(asked) == 4


def test_a_second_diagnosis_that_fails_is_a_result_and_no_end_of_the_run(run, monkeypatch):
    def refused(dataset, scene, **_):
        raise DataError("the commands do not match")

    monkeypatch.setattr(follow_up, "diagnose", refused)
    first = results(run, said("ambiguous"), said("ambiguous"))
    found = follow_up.follow_up(run.folder, run.places, first, run.labels)
    assert [(r.error, r.report) for r in found.values()] == [("the commands do not match", None)] * 2
    outcome = Outcome(run.labels["case-0001"], found["case-0001"])
    rows = {r.measure: r for r in score_run([outcome], scene="arm", cases=1, followed=[outcome]).rows}
    assert rows["ambiguous: right once the next motion is recorded"].value == 0


def test_a_tie_without_a_motion_to_play_is_not_followed(run):
    silent = said("ambiguous")
    task = silent.model_copy(update={"next_motion": NextMotion(name="slow")})
    some = results(run, said("no_gap"), task)
    assert not any(follow_up.proposes(r) for r in some)
    assert not follow_up.proposes(some[0].model_copy(update={"report": None}))


def test_the_table_counts_what_came_right(run):
    tie, right = results(run, said("ambiguous"), said("explained", "joint_damping"))
    label = run.labels["case-0001"]
    outcome = Outcome(label, tie)
    followed = [replace(outcome, result=right), replace(outcome, result=tie)]
    rows = {r.measure: r for r in score_run([outcome], scene="arm", cases=1, followed=followed).rows}
    row = rows["ambiguous: right once the next motion is recorded"]
    assert (row.value, row.n) == (50.0, 2)
    assert "ambiguous: right once the next motion is recorded" not in {
        r.measure for r in score_run([outcome], scene="arm", cases=1).rows
    }
