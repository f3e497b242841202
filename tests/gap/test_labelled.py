"""Labelled recordings: all pairs of settings, their labels, and the score of the answers."""

from __future__ import annotations

import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import DataError, UnknownNameError, UsageError
from candata.gap.blind import setting_pairs as labelled_module
from candata.gap.blind.labelled_set import pairs_of, read_labelled
from candata.gap.blind.setting_pairs import SETTINGS, run_pairs, score_pairs
from candata.schema.effect import EffectSetting
from candata.schema.episode import Episode
from candata.schema.labelled import PairResult
from candata.schema.manifest import Lineage
from candata.schema.report import DiagnosisData, EpisodeCount, Estimate, NamedEffect, Report
from candata.simulate import with_effects
from candata.simulate.crew import alone
from tests.gap.conftest import ARM, ROLES

LABELS = """dataset: runs
scene: scene.yaml
settings: settings.csv
same: group
causes:
  gain: {effects: [servo_gain], size: {effect: servo_gain, parameter: kp_scale}}
  mass: {effects: [armature, object_mass]}
"""


@pytest.fixture
def folder(tmp_path, arm_episodes):
    """Three settings of four runs each: one changes the gain, one nothing that can be measured."""
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "scene.yaml").write_text(ROLES)
    (tmp_path / "labels.yaml").write_text(LABELS)
    create_dataset(tmp_path / "runs")
    episodes = arm_episodes(count=12, rows=40)
    append(tmp_path / "runs", episodes, Lineage(operation="test"))
    settings = [("1", "1", "g")] * 4 + [("2", "1", "")] * 4 + [("1", "1.5", "g")] * 4
    rows = [f"{e.meta.id},{','.join(s)}" for e, s in zip(episodes, settings, strict=True)]
    (tmp_path / "settings.csv").write_text("\n".join(["episode,gain,mass,group", *rows, ""]))
    return tmp_path


def answer(verdict: str, *effects: tuple[str, float], tied: tuple[str, ...] = ()) -> Report:
    named = tuple(
        NamedEffect(
            name=n, share=1.0, support=1.0, parameters={"kp_scale": Estimate(value=v, low=0.9 * v, high=1.1 * v)}
        )
        for n, v in effects
    )
    data = DiagnosisData(dataset="x", episodes=EpisodeCount(total=4, folds=4, held_out=4))
    return Report(verdict=verdict, effects=named, ambiguous_class=tied, data=data)


def crew_of(answers):
    """Return a crew that diagnoses nothing: each pair gets the answer that the test gives it."""

    def crew(work, tasks):
        for *_, a, b, label, ratio, _seed in tasks:
            said = answers(a, b, label)
            yield PairResult(a=a, b=b, label=label, ratio=ratio, cpu_s=2.0, report=said)

    return crew


def test_all_pairs_and_halves_are_made(folder, tmp_path):
    labelled = read_labelled(folder)
    pairs = {(p.a, p.b): p for p in pairs_of(labelled)}
    first, gain, same = "gain-1_mass-1", "gain-2_mass-1", "gain-1_mass-1.5"
    assert set(labelled.labels) == {first, gain, same}
    assert (pairs[first, gain].label, pairs[first, gain].ratio) == ("gain", 2.0)
    assert pairs[gain, first].ratio == 0.5
    assert pairs[first, same].label is None  # the table says that no measurement tells them apart
    assert (gain, same) not in pairs  # two labels differ
    assert pairs[f"{gain}.first", f"{gain}.second"].label is None
    results = run_pairs(labelled, tmp_path / "out", crew_of(lambda *_: answer("no_gap")))
    assert len(results) == len(pairs) == 7
    halves = [open_dataset(tmp_path / "out" / SETTINGS / f"{gain}.{side}").ids for side in ("first", "second")]
    assert sorted((*halves[0], *halves[1])) == sorted(labelled.episodes[gain])


def test_a_label_that_changes_nothing_makes_nulls(folder):
    (folder / "labels.yaml").write_text(LABELS.replace("same: group\n", "").replace("[armature, object_mass]", "[]"))
    labels = {p.label for p in pairs_of(read_labelled(folder)) if {p.a, p.b} == {"gain-1_mass-1", "gain-1_mass-1.5"}}
    assert labels == {None}


def test_answers_are_held_to_the_labels(folder, tmp_path):
    labelled = read_labelled(folder)

    def answers(a, b, label):
        if label is None:
            return answer("no_gap") if a.startswith("gain-1") else answer("explained", ("armature", 1.0))
        return (
            answer("explained", ("servo_gain", 1.9), ("backlash", 1.0))
            if b.startswith("gain-2")
            else answer("ambiguous", tied=("servo_gain", "backlash"))
        )

    rows = {r.measure: r for r in score_pairs(labelled, run_pairs(labelled, tmp_path / "out", crew_of(answers))).rows}
    assert rows["nulls with an effect named"].value == pytest.approx(20.0)
    assert rows["nulls that are no_gap"].value == pytest.approx(80.0)
    assert rows["changes named first, or in the class"].value == 100.0
    assert rows["changes with a wrong second name"].value == 50.0
    assert rows["median error of a size against the label"].value == pytest.approx(5.0)
    assert rows["labels inside the 90 % interval"].value == 100.0


def test_a_second_run_goes_on_with_what_stands(folder, tmp_path):
    labelled, asked = read_labelled(folder), []

    def answers(a, b, label):
        asked.append((a, b))
        return answer("no_gap")

    first = run_pairs(labelled, tmp_path / "out", crew_of(answers))
    assert len(asked) == len(first)
    assert run_pairs(labelled, tmp_path / "out", crew_of(answers)) == first
    assert len(asked) == len(first)


def test_another_question_in_the_same_folder_is_refused(folder, tmp_path):
    crew = crew_of(lambda *_: answer("no_gap"))
    run_pairs(read_labelled(folder), tmp_path / "out", crew)
    with pytest.raises(UsageError, match="asked for something else"):
        run_pairs(read_labelled(folder), tmp_path / "out", crew, seed=1)


def test_effects_that_the_scene_holds_are_part_of_the_question(folder, tmp_path):
    (folder / "labels.yaml").write_text(LABELS + "effects: effects.yaml\n")
    crew = crew_of(lambda *_: answer("no_gap"))
    known = "effects: [{name: speed_limit, parameters: {speed_rad_s: 2.0}}]\n"
    (folder / "effects.yaml").write_text(known)
    run_pairs(read_labelled(folder), tmp_path / "out", crew)
    (folder / "effects.yaml").write_text(known.replace("2.0", "1.0"))
    with pytest.raises(UsageError, match="asked for something else"):
        run_pairs(read_labelled(folder), tmp_path / "out", crew)


def test_the_scene_is_fitted_once_to_each_reference_and_holds_what_is_known(folder, tmp_path, monkeypatch):
    (folder / "labels.yaml").write_text(LABELS + "effects: effects.yaml\n")
    (folder / "effects.yaml").write_text("effects: [{name: speed_limit, parameters: {speed_rad_s: 2.0}}]\n")
    fitted, worlds = [], []

    def near(reference, scene, *, seed):
        fitted.append(reference.name)
        return with_effects(scene, (EffectSetting(name="armature", parameters={"armature_kgm2": 0.01}),))

    def diagnosed(data, world, **options):
        worlds.append([setting.name for setting in world.given_effects])
        raise DataError("not diagnosed here")

    monkeypatch.setattr(labelled_module, "near_reference", near)
    monkeypatch.setattr(labelled_module, "diagnose", diagnosed)
    results = run_pairs(read_labelled(folder), tmp_path / "out", alone)
    assert len(results) == len(worlds) == 7
    assert sorted(fitted) == sorted({r.a for r in results})
    assert all(names == ["speed_limit", "armature"] for names in worlds)


def test_settings_of_which_nothing_was_repeated_have_no_halves(folder):
    table = folder / "settings.csv"
    table.write_text("\n".join(table.read_text().splitlines()[:3]) + "\n")  # a slow and a fast run
    assert pairs_of(read_labelled(folder)) == []


def test_long_runs_are_cut(folder, tmp_path):
    (folder / "labels.yaml").write_text(LABELS + "cut_s: 0.2\n")
    labelled = read_labelled(folder)
    run_pairs(labelled, tmp_path / "out", crew_of(lambda *_: answer("no_gap")))
    pieces = list(open_dataset(tmp_path / "out" / SETTINGS / "gain-2_mass-1").episodes())
    assert len(pieces) == 8
    assert {len(p) for p in pieces} == {20}
    assert {int(p["time_ns"][0]) for p in pieces} == {0}


@pytest.mark.parametrize(
    ("file", "old", "new", "kind", "text"),
    [
        ("labels.yaml", "servo_gain]", "servo_gian]", UnknownNameError, "servo_gain"),
        ("labels.yaml", "  mass:", "  weight:", DataError, "no column weight"),
        ("settings.csv", "arm-003", "arm-999", DataError, "arm-999"),
        ("labels.yaml", "settings.csv", "none.csv", UsageError, "cannot be read"),
        ("labels.yaml", "dataset: runs", "dataset: runs\nmore: 1", UsageError, "more"),
    ],
)
def test_what_is_wrong_in_the_labels_is_said(folder, file, old, new, kind, text):
    path = folder / file
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(kind, match=text):
        read_labelled(folder)


def test_labels_may_be_those_that_episodes_keep(folder, arm_episodes):
    """Then no table is needed; the command may name the recordings."""
    (folder / "labels.yaml").write_text("scene: scene.yaml\ncauses: {gain: {effects: [servo_gain]}}\n")
    create_dataset(folder / "others")
    episodes = [
        Episode(e.meta.model_copy(update={"labels": {"gain": 100 * (1 + i % 2)}}), e.arrays)
        for i, e in enumerate(arm_episodes(count=4, rows=40))
    ]
    append(folder / "others", episodes, Lineage(operation="test"))
    labelled = read_labelled(folder, str(folder / "others"))
    assert {name: len(ids) for name, ids in labelled.episodes.items()} == {"gain-100": 2, "gain-200": 2}
    assert {p.ratio for p in pairs_of(labelled) if p.label} == {0.5, 2.0}
    with pytest.raises(UsageError, match="no recordings"):
        read_labelled(folder)
    (folder / "labels.yaml").write_text("scene: scene.yaml\ncauses: {mass: {effects: [servo_gain]}}\n")
    with pytest.raises(DataError, match="no label mass"):
        read_labelled(folder, str(folder / "others"))


def test_a_folder_without_labels_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"labels\.yaml"):
        read_labelled(tmp_path)
