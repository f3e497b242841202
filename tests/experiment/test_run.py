"""Cells: kept, gone on with, and one that fails takes only its own rows along."""

from __future__ import annotations

import shutil

import pytest

from candata.datasets import open_dataset
from candata.effects import read_randomisation
from candata.errors import CandataError, UsageError
from candata.experiment.config import SealedWorld, read_experiment
from candata.experiment.plan import plan_cells
from candata.experiment.run import run_experiment
from candata.experiment.sources import make_sealed, opened_effects, repaired_options
from candata.experiment.table import REPLAYED
from candata.reports import write_diagnosis
from candata.schema.effect import EffectSetting
from candata.simulate.recipe import SetRecipe
from candata.simulate.seal import read_seal
from tests.experiment.conftest import TINY, standing_set


def table_of(path, out, **more):
    """The table of an experiment's file."""
    return run_experiment(plan_cells(read_experiment(path)), out, write_diagnosis, **more)


def test_a_run_that_was_stopped_goes_on_to_the_same_bytes(experiment_file, tmp_path):
    path = experiment_file(regimes=["sim", "real-finetune"])
    whole = table_of(path, tmp_path / "whole")

    def stop(words: str) -> None:
        if words.startswith("train/single/mlp/nominal/sim"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        table_of(path, tmp_path / "parts", stage=stop)
    assert not (tmp_path / "parts" / "table.json").exists()
    standing = {file: file.stat().st_mtime_ns for file in (tmp_path / "parts").glob("cells/*/cell.json")}
    table_of(path, tmp_path / "parts")
    assert (tmp_path / "parts" / "table.json").read_bytes() == (tmp_path / "whole" / "table.json").read_bytes()
    assert standing
    assert all(file.stat().st_mtime_ns == time for file, time in standing.items())
    shown = [(row.label, row.real_count) for row in whole.rows]
    assert shown == [("stays", 0), ("mlp, sim", 0), ("mlp, real-finetune", None)]
    assert all(row.adds_auc.value is not None and row.mse.value is not None for row in whole.rows)
    assert all(row.adds_auc.low is None for row in whole.rows)
    assert whole.notes == ("fewer than 30 test episodes, so no intervals: single", REPLAYED)


def test_a_cell_that_fails_is_named_in_its_rows_and_the_others_stand(experiment_file, tmp_path):
    standing_set(tmp_path, "short", 10, rows=5)
    data = {name: {"path": name} for name in ("sim", "real", "short")}
    columns = {"long": {"sim": "sim", "real": "real"}, "short": {"sim": "sim", "real": "short"}}
    table = table_of(experiment_file(data=data, columns=columns, regimes=["sim"]), tmp_path / "out")
    rows = {(row.column, row.label): row for row in table.rows}
    assert rows["long", "mlp, sim"].adds_auc.value is not None
    assert rows["long", "mlp, sim"].failed is None
    assert rows["short", "mlp, sim"].adds_auc.value is None
    assert "no episode is long enough" in rows["short", "mlp, sim"].failed
    failed_name = "evaluation/short/mlp/nominal/sim/train-0/seed-0"
    assert set(table.failed) == {failed_name, "evaluation/short/rows"}


def test_a_repair_that_fails_takes_its_own_row_alone_along(experiment_file, tmp_path):
    columns = {"single": {"sim": "sim", "real": "real", "scene": "cube_toss"}}  # not the scene of these recordings
    table = table_of(
        experiment_file(columns=columns, regimes=["sim"], rows=["stays", "repaired simulator"]), tmp_path / "o"
    )
    rows = {row.label: row for row in table.rows}
    assert rows["stays"].adds_auc.value is not None
    assert rows["mlp, sim"].adds_auc.value is not None
    assert rows["repaired simulator"].adds_auc.value is None
    assert "148 Hz" in rows["repaired simulator"].failed


def test_a_damaged_cell_is_made_again(experiment_file, tmp_path):
    path = experiment_file(regimes=["sim"])
    first = table_of(path, tmp_path / "out")
    for file in (tmp_path / "out").glob("cells/evaluation-*/cell.json"):
        file.write_text("{")
    assert table_of(path, tmp_path / "out") == first
    for folder in (tmp_path / "out").glob("cells/train-*/run"):
        shutil.rmtree(folder)
    evaluations = [*(tmp_path / "out").glob("cells/evaluation-*/evaluation.json")]
    for file in evaluations:
        file.unlink()
    assert table_of(path, tmp_path / "out") == first
    evaluations[0].write_text("{")
    with pytest.raises(CandataError, match="no JSON") as refusal:
        table_of(path, tmp_path / "out")
    assert str(evaluations[0]) in str(refusal.value)


def test_a_set_under_another_name_is_the_same_cell(experiment_file, tmp_path):
    first = table_of(experiment_file(regimes=["sim"]), tmp_path / "out")
    data = {name: {"path": path} for name, path in {"simulation": "sim", "twin": "sim", "real": "real"}.items()}
    columns = {"single": {"sim": "simulation", "real": "real"}, "again": {"sim": "twin", "real": "real"}}
    table = table_of(experiment_file(regimes=["sim"], data=data, columns=columns), tmp_path / "out")
    assert not table.failed
    values = {(row.column, row.label): row.adds_auc for row in table.rows}
    assert values["single", "mlp, sim"] == values["again", "mlp, sim"] == first.rows[1].adds_auc


def test_real_episodes_are_counted_and_no_test_episode_is_trained_on(experiment_file, tmp_path):
    path = experiment_file(regimes=["real"], real_counts=[0, 3])
    table = table_of(path, tmp_path / "out")
    assert [(row.label, row.real_count) for row in table.rows] == [("stays", 0), ("mlp, real", 3)]
    parts = [open_dataset(file.parent / "set") for file in (tmp_path / "out").glob("cells/part-*/cell.json")]
    test, trained = sorted(parts, key=len)
    assert (len(test), len(trained)) == (1, 3)
    assert not set(test.ids) & set(trained.ids)


@pytest.mark.parametrize(
    "difference", [{"outside": "wind"}, {"all_wrong": True}, {"hidden": "heavy.yaml"}], ids=lambda d: next(iter(d))
)
def test_a_world_is_made_again_from_its_seal_alone(tmp_path, difference):
    (tmp_path / "heavy.yaml").write_text(
        "effects: [{name: object_mass, parameters: {mass_scale: {uniform: [1.5, 1.6]}}}]\n"
    )
    if "hidden" in difference:
        difference = {"hidden": str(tmp_path / "heavy.yaml")}
    world = SealedWorld(scene="cube_toss", train=2, test=2, duration_s=0.2, **difference)
    sets = [
        make_sealed(tmp_path / name, world, tmp_path / "seals" / "seal.json", 1, None, lambda count: None)
        for name in ("a", "b")
    ]
    assert sets[0].digest == sets[1].digest
    assert all(episode.meta.point_cloud and not episode.meta.effects for episode in sets[0])
    effects = opened_effects(tmp_path / "seals" / "seal.json", sets[0])
    other = world.model_copy(update={"scene": "gripper_tabletop"})
    with pytest.raises(UsageError, match=r"seal.* another"):
        make_sealed(tmp_path / "c", other, tmp_path / "seals" / "seal.json", 1, None, lambda count: None)
    if "outside" in difference:
        assert effects is None
    elif "hidden" in difference:
        assert effects == read_seal(tmp_path / "seals" / "seal.json").effects
        assert 1.5 <= effects[0].parameters["mass_scale"] <= 1.6
    else:
        assert len(effects) > 3


def test_the_seal_is_opened_for_the_floor_and_shares_of_the_gap_count_from_it(experiment_file, tmp_path):
    (tmp_path / "hidden.yaml").write_text(
        "effects: [{name: sliding_friction, parameters: {scale: {uniform: [3.0, 3.1]}}}]\n"
    )
    real = {"scene": "cube_toss", "hidden": "hidden.yaml", "duration_s": 0.6, "train": 2, "test": 3}
    data = {
        "sim": {"generate": {"scene": "cube_toss", "episodes": 4, "duration_s": 0.6}},
        "real": {"sealed": real},
    }
    models = {"mlp": TINY, "other": {"model": "mlp", **TINY}}
    windows = {"history": 3, "horizon": 4, "rate_hz": 37}
    path = experiment_file(data=data, models=models, regimes=["sim"], rows=["simulator"], windows=windows)
    plan = plan_cells(read_experiment(path)).chosen(["mlp"])
    table = run_experiment(plan, tmp_path / "out", write_diagnosis)
    facts, rows = table.columns["single"], {row.label: row for row in table.rows}
    assert len(facts.opened) == 1
    assert facts.opened[0].startswith("sliding_friction scale 3.0")
    assert facts.floor == "the simulator with what the seal held"
    assert facts.floor_auc > rows["simulator"].adds_auc.value
    assert rows["simulator"].closed.value == pytest.approx(0.0)
    assert rows["simulator"].excess > 1
    assert table.headline.startswith("the model (mlp) ")
    assert "of the gap" in table.headline


def test_a_repair_takes_the_place_of_what_was_drawn(tmp_path):
    text = (
        "effects:\n- {name: object_mass, parameters: {mass_scale: {uniform: [0.5, 2.0]}}}\n"
        "- {name: sliding_friction, parameters: {scale: {uniform: [0.5, 2.0]}}}\n"
    )
    (tmp_path / "random.yaml").write_text(text)
    file = {"scene": "cube_toss", "episodes": 4, "randomise": str(tmp_path / "random.yaml")}
    repair = (EffectSetting(name="object_mass", parameters={"mass_scale": 1.4}),)
    drawn = repaired_options(SetRecipe(**file), repair)["randomisation"]
    assert [effect.name for effect in drawn] == ["object_mass", "sliding_friction"]
    assert drawn[0].parameters == {"mass_scale": 1.4}
    assert drawn[1] == read_randomisation(tmp_path / "random.yaml").effects[1]


def test_a_world_that_is_drawn_anew_is_not_mixed_with_the_one_before(experiment_file, tmp_path):
    (tmp_path / "hidden.yaml").write_text(
        "effects: [{name: sliding_friction, parameters: {scale: {uniform: [1.0, 3.0]}}}]\n"
    )
    world = {"scene": "cube_toss", "hidden": "hidden.yaml", "duration_s": 0.6, "train": 2, "test": 3}
    windows = {"history": 3, "horizon": 4, "rate_hz": 37}
    data, columns = {"real": {"sealed": world}}, {"c": {"real": "real"}}
    path = experiment_file(data=data, columns=columns, regimes=["real"], windows=windows)
    table_of(path, tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / "seals")
    for folder in (tmp_path / "out" / "cells").glob("data-*"):
        shutil.rmtree(folder)
    second = table_of(path, tmp_path / "out")
    shutil.copytree(tmp_path / "out" / "seals", tmp_path / "fresh" / "seals")
    assert table_of(path, tmp_path / "fresh").rows == second.rows
