"""Fresh episodes: what is named is tried on recordings of the hidden world that no search has seen."""

from __future__ import annotations

import numpy as np
import pytest

from candata.datasets import open_dataset
from candata.gap.blind import fresh_gaps
from candata.gap.blind.cases import CASES, make_cases, read_cases
from candata.gap.blind.fresh_gaps import is_recordable, measure_fresh_gaps
from candata.gap.blind.labels import open_labels, seal_labels
from candata.gap.blind.outcomes import Outcome
from candata.gap.blind.runs import Place
from candata.gap.blind.scores import score_run
from candata.scenes import load_scene
from candata.schema.bench import CaseResult, LabelsFile
from candata.schema.effect import EffectSetting
from tests.gap.conftest import ARM, ROLES
from tests.gap.outcomes import case, say

SMALL = {"seed": 3, "episodes": 2, "duration_s": 0.8}
FRESH = 6


@pytest.fixture(scope="module")
def sealed_case(tmp_path_factory):
    """A sealed case of a damped arm: its folder, its labels and what opens it."""
    folder = tmp_path_factory.mktemp("fresh")
    (folder / "arm.xml").write_text(ARM)
    scene = folder / "scene.yaml"
    scene.write_text(ROLES)
    sealed = seal_labels(folder, load_scene(scene), {"one": 1}, only=("joint_damping",), salt="ab" * 32, **SMALL)
    make_cases(folder, str(scene), sealed, **SMALL)
    ((path, file),) = read_cases(folder / CASES).items()
    (label,) = open_labels({path: file}, sealed).values()
    return Place(path, str(scene), file.sealed), label, sealed


def outcome(sealed_case, named, claimed=0.95):
    """Name effects in the case, and claim to close a share of its gap."""
    place, label, _ = sealed_case
    report = case("one", label.effects, tuple(say(s) for s in named), closed=claimed).result.report
    return Outcome(label, CaseResult(case=place.folder.name, sealed=place.sealed, cpu_s=1.0, cold=False, report=report))


def fresh(sealed_case, out, *outcomes, **more):
    place, _, sealed = sealed_case
    return measure_fresh_gaps(out, [place], outcomes, sealed, FRESH, **more)


def test_the_truth_closes_the_gap_on_fresh_episodes_and_half_of_it_less(sealed_case, tmp_path):
    truth = sealed_case[1].effects[0]
    value = truth.parameters["damping_Nms_rad"]
    closed = {}
    for share in (1.0, 0.5):
        named = truth.model_copy(update={"parameters": {"damping_Nms_rad": share * value}})
        (found,) = fresh(sealed_case, tmp_path / str(share), outcome(sealed_case, [named])).values()
        assert (found.episodes, found.error) == (FRESH, None)
        assert found.gap.before > 1.5
        closed[share] = found.gap.closed
    # Six episodes in their own noise: what is left of the true world is luck of the floor.
    assert closed[1.0] > 0.95
    assert 0.2 < closed[0.5] < 0.9


def test_fresh_episodes_are_others_than_those_of_the_case(sealed_case, tmp_path, monkeypatch):
    recorded = []
    record = fresh_gaps.hidden_world
    monkeypatch.setattr(fresh_gaps, "hidden_world", lambda *a: recorded.extend(record(*a)) or recorded)
    fresh(sealed_case, tmp_path, outcome(sealed_case, sealed_case[1].effects))
    known = list(open_dataset(sealed_case[0].folder))
    assert len(recorded) == FRESH
    assert {e.meta.task for e in known} <= {e.meta.task for e in recorded}
    for episode in known:
        assert all(np.abs(episode["action"] - other["action"]).max() > 0.01 for other in recorded)


def test_what_stands_is_not_recorded_again_and_nothing_named_is_not_tried(sealed_case, tmp_path, monkeypatch):
    one, told = outcome(sealed_case, sealed_case[1].effects), []
    first = fresh(sealed_case, tmp_path, one, told=told.append)
    monkeypatch.setattr(fresh_gaps, "fresh_gap", None)
    assert fresh(sealed_case, tmp_path, one, told=told.append) == first
    assert told == [1]
    assert fresh(sealed_case, tmp_path / "silent", outcome(sealed_case, [])) == {}
    assert fresh(sealed_case, tmp_path / "late", one, until=0.0) == {}


def test_an_effect_that_cannot_be_tried_is_an_error_of_its_case(sealed_case, tmp_path):
    unknown = EffectSetting(name="joint_damping", element="wrist", parameters={"damping_Nms_rad": 0.1})
    (found,) = fresh(sealed_case, tmp_path, outcome(sealed_case, [unknown])).values()
    assert found.gap is None
    assert "wrist" in found.error


def test_the_table_holds_the_claim_against_fresh_episodes(sealed_case, tmp_path):
    one = outcome(sealed_case, sealed_case[1].effects, claimed=0.5)
    measured = Outcome(one.label, one.result, fresh=fresh(sealed_case, tmp_path, one)[one.label.case])
    score = score_run([measured, one], scene="arm", cases=2)
    row = next(r for r in score.rows if r.measure == "closed as claimed minus on fresh episodes: mean")
    assert row.value == pytest.approx(100 * (0.5 - measured.closed_fresh))
    assert (row.n, row.is_met) == (1, False)
    assert row.interval == pytest.approx((row.value, row.value))
    assert [s.overclaimed for s in score.scores] == [measured.overclaimed, None]


def test_only_worlds_that_candata_played_in_one_scene_can_be_recorded_again(sealed_case):
    assert is_recordable(sealed_case[2])
    assert not is_recordable(LabelsFile(salt="", labels={}))
    assert not is_recordable(LabelsFile(salt="", asked={"world": "random-small", "seed": 1}, labels={}))
