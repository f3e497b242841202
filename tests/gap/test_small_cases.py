"""Cases in random small scenes on disk, their labels and their score."""

from __future__ import annotations

import json

import numpy as np
import pytest

from candata.datasets import open_dataset
from candata.errors import UsageError
from candata.gap.blind.cases import CASE, CASES, read_cases, scene_of
from candata.gap.blind.labels import open_labels, read_labels
from candata.gap.blind.misses import miss
from candata.gap.blind.outcomes import Outcome
from candata.gap.blind.rigs.cases import make_rig_cases, null_traits, seal_rig_labels
from candata.gap.blind.rigs.design import TRAITS, all_traits
from candata.gap.blind.scores import score_run
from candata.scenes import load_scene
from candata.schema.bench import CaseResult, Label
from candata.schema.effect import EffectSetting
from candata.schema.report import DiagnosisData, EpisodeCount, Estimate, NamedEffect, Report

SALT = "cd" * 32
COUNTS = {"null": 2, "one": 1}
SMALL = {"episodes": 2, "duration_s": 1.2}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A small run with its cases made."""
    out = tmp_path_factory.mktemp("small")
    sealed = seal_rig_labels(out, COUNTS, seed=1, only=("servo_gain",), salt=SALT, **SMALL)
    make_rig_cases(out, sealed, **SMALL)
    return out


def test_a_case_brings_its_own_scene_and_is_read_as_all_cases_are(run):
    cases, sealed = read_cases(run / CASES), read_labels(run / "sealed.json")
    labels = open_labels(cases, sealed)
    assert sorted(label.kind for label in labels.values()) == ["null", "null", "one"]
    for path, case in cases.items():
        scene, data = load_scene(scene_of(path, case)), open_dataset(path)
        assert scene.name == str((path / "scene.yaml").resolve())
        assert len(data) == case.episodes == 2
        for episode in data:
            assert episode.meta.joint_names
            assert episode["joint_position"].shape[1] == len(scene.file.joints)
            assert ("object_pose" in episode) == (scene.file.object is not None)
            assert ("fingertip_contact" in episode) == bool(scene.file.fingertips)


def test_a_case_tells_nothing_of_its_label(run):
    labels = read_labels(run / "sealed.json").labels
    for path, case in read_cases(run / CASES).items():
        told = "\n".join(
            f.read_text() for f in (*path.rglob("*.json"), path / "scene.yaml") if f.name != "dataset.json"
        )
        label = json.loads(labels[case.name])
        assert "servo_gain" not in told
        assert str(label["seed"]) not in told


def test_the_same_seed_and_salt_seal_and_record_the_same(run, tmp_path):
    again = seal_rig_labels(tmp_path, COUNTS, seed=1, only=("servo_gain",), salt=SALT, **SMALL)
    assert again == read_labels(run / "sealed.json")
    make_rig_cases(tmp_path, again, **SMALL)
    for path in read_cases(run / CASES):
        one, other = open_dataset(path), open_dataset(tmp_path / CASES / path.name)
        assert one.digest == other.digest
        assert (path / "scene.xml").read_text() == (tmp_path / CASES / path.name / "scene.xml").read_text()


def test_a_run_goes_on_with_what_is_missing_and_refuses_another_request(run):
    sealed = seal_rig_labels(run, COUNTS, seed=1, only=("servo_gain",), **SMALL)
    (run / CASES / "case-0002" / CASE).unlink()
    made = []
    make_rig_cases(run, sealed, **SMALL, told=made.append)
    assert made == ["case-0002"]
    with pytest.raises(UsageError, match="asked for something else"):
        seal_rig_labels(run, COUNTS | {"null": 3}, seed=1, only=("servo_gain",), **SMALL)


def test_half_of_the_nulls_are_plain_and_the_others_take_turns():
    drawn = null_traits(44, np.random.default_rng(0))
    assert drawn.count("plain") == 22
    assert {drawn.count(t) for t in all_traits() if t != "plain"} == {2}
    assert {t.split()[0] for t in drawn} == set(TRAITS)
    assert null_traits(4, np.random.default_rng(0), ["spring"]) == ["spring"] * 4


def outcome(kind, trait, verdict, named=(), tied=(), cpu_s=1.0):
    truth = EffectSetting(name="object_mass", parameters={"mass_scale": 1.5})
    effects = tuple(
        NamedEffect(name=n, share=1.0, support=0.9, parameters={"x": Estimate(value=1.0, low=0.9, high=1.1)})
        for n in named
    )
    report = Report(
        verdict=verdict,
        effects=effects,
        ambiguous_class=tied,
        data=DiagnosisData(dataset="d", episodes=EpisodeCount(total=12, folds=4, held_out=12)),
    )
    label = Label(case="case-0001", kind=kind, trait=trait, effects=(truth,) if kind == "one" else ())
    return Outcome(label, CaseResult(case="case-0001", sealed="s", cpu_s=cpu_s, cold=True, report=report))


def measured(outcomes):
    found = score_run(outcomes, scene="s", cases=len(outcomes))
    return {r.measure.removeprefix("small scenes, "): r for r in found.rows}


def test_a_null_is_right_only_with_no_gap_and_counted_by_trait():
    some = [
        outcome("null", "plain", "no_gap"),
        outcome("null", "plain", "unknown_effect"),
        outcome("null", "mimic cut", "explained", named=("servo_gain",)),
        outcome("null", "mimic cut", "no_gap"),
    ]
    rows = measured(some)
    assert rows["null: no_gap"].value == 50
    assert (rows["null: an effect named"].value, rows["null: an effect named"].is_met) == (25, False)
    assert rows["null: unknown_effect"].value == 25
    assert (rows["null, mimic cut: no_gap"].value, rows["null, mimic cut: no_gap"].n) == (50, 2)
    assert [m.why if (m := miss(o)) else None for o in some] == [
        None,
        "no gap is there (plain)",
        "an effect named",
        None,
    ]
    assert "null: an effect named" in measured([outcome("null", None, "no_gap")])


def test_a_single_cause_is_right_alone_ambiguous_with_it_in_the_class_or_wrong():
    some = [
        outcome("one", "plain", "explained", named=("object_mass",)),
        outcome("one", "plain", "explained", named=("object_mass", "servo_gain")),
        outcome("one", "plain", "ambiguous", tied=("object_mass", "armature")),
        outcome("one", "plain", "ambiguous", tied=("servo_gain", "armature")),
    ]
    rows = measured(some)
    assert rows["one effect: first, nothing wrong beside"].value == 25
    assert rows["one effect: ambiguous, the effect in the class"].value == 25
    assert rows["one effect: a wrong name"].value == 25
    missed = [miss(o) for o in some]
    assert [m.why if m else None for m in missed] == [None, "a wrong name beside", "not first", "not first"]
