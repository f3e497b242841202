"""The file of an experiment: what it may say, and what is refused before anything is made."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import mujoco
import pytest

from candata.datasets import open_dataset
from candata.errors import CandataError, DataError, UnknownNameError, UsageError
from candata.experiment.cells import digests, versions
from candata.experiment.config import read_experiment
from candata.experiment.plan import plan_cells
from candata.loaders import make_split, save_split
from tests.experiment.conftest import TINY

SEALED = {"scene": "cube_toss", "train": 100, "test": 200}
MADE = {"sim": {"generate": {"scene": "cube_toss", "episodes": 20}}, "real": {"sealed": SEALED | {"outside": "wind"}}}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"colums": {}}, "unknown key `colums`, did you mean `columns`"),
        ({"models": {"mpl": TINY}}, "unknown model 'mpl'"),
        ({"models": {"mlp": {"config": {"widht": 3}}}}, "did you mean `width`"),
        ({"models": {"mlp": {"step": 3}}}, "unknown key `step`, did you mean `steps`"),
        ({"columns": {"a": {"sim": "smi", "real": "real"}}}, "unknown source of data in column a 'smi'"),
        ({"columns": {"a": {"real": "real"}}}, "column a has no simulated set"),
        ({"regimes": ["finetune"]}, "regimes.0"),
        ({"mixture": {"sim": 1.0}}, "expected shares of sim and real"),
        ({"without_contact": "unet2"}, "unknown model of the experiment 'unet2'"),
        ({"data": {"sim": {"path": "sim"}, "real": {"sealed": SEALED}}}, "expected one of hidden, outside"),
        ({"data": {"sim": {"path": "sim"}, "real": {"sealed": SEALED | {"outside": "wnd"}}}}, "unknown outside cause"),
        ({"data": MADE, "models": {"mlp": {"config": {"widht": 3}}}}, "did you mean `width`"),
        ({"data": MADE, "windows": {"horizon": 33}}, "the episodes of real are shorter than the horizon"),
        ({"data": MADE, "models": {"mlp": {"preset": "smal"}}}, "unknown preset 'smal'"),
        ({"data": MADE | {"real": {"sealed": SEALED | {"hidden": "no.yaml"}}}}, "the file of `hidden` is not there"),
        ({"data": {"sim": {"path": "sim"}, "real": {"path": "real", "recipe": "a.yaml"}}}, "expected one of path"),
    ],
)
def test_what_means_nothing_is_refused_in_words(experiment_file, changes, words):
    with pytest.raises(UsageError) as refusal:
        plan_cells(read_experiment(experiment_file(**changes)))
    assert words in str(refusal.value)


def test_a_scale_is_of_episodes_and_steps_but_leaves_real_and_test_episodes_enough(experiment_file):
    data = {
        "sim": {"generate": {"scene": "cube_toss", "episodes": 1000}},
        "real": {"sealed": SEALED | {"all_wrong": True}},
    }
    models = {"mlp": {"steps": 1000, "fine_tune_steps": 100}}
    path = experiment_file(data=data, models=models, real_counts=[0, 10, 100])
    file = read_experiment(path, 0.05)
    world = file.data["real"].sealed
    assert (file.data["sim"].generate.episodes, file.models["mlp"].steps, file.models["mlp"].fine_tune_steps) == (
        50,
        50,
        20,
    )
    assert (world.train, world.test, file.real_counts) == (30, 200, (0, 10, 30))
    for scale in (0.0, 1.5):
        with pytest.raises(UsageError, match="--scale is out of range"):
            read_experiment(path, scale)


def test_more_real_episodes_than_a_world_has_are_refused(experiment_file):
    data = {"sim": {"path": "sim"}, "real": {"sealed": SEALED | {"all_wrong": True}}}
    with pytest.raises(UsageError, match="more real training episodes"):
        read_experiment(experiment_file(data=data, real_counts=[101]))


def test_a_recipe_is_read_with_its_paths_seen_from_its_own_folder(experiment_file, tmp_path):
    (tmp_path / "recipes").mkdir()
    (tmp_path / "recipes" / "r.yaml").write_text("effects: []\n")
    (tmp_path / "recipes" / "set.yaml").write_text("scene: cube_toss\nepisodes: 20\nrandomise: r.yaml\n")
    data = {"sim": {"recipe": "recipes/set.yaml"}, "real": {"path": "real"}}
    generation = read_experiment(experiment_file(data=data)).data["sim"].generate
    assert generation.randomise == str(tmp_path / "recipes" / "r.yaml")
    (tmp_path / "recipes" / "set.yaml").write_text("scene: cube_toss\nepisods: 20\n")
    with pytest.raises(UsageError, match="did you mean `episodes`"):
        read_experiment(experiment_file(data=data))


def test_a_set_that_is_not_there_and_a_channel_that_no_public_set_has_are_refused(experiment_file):
    missing = {"sim": {"path": "sim"}, "real": {"path": "elsewhere"}}
    with pytest.raises(DataError, match="candata fetch"):
        plan_cells(read_experiment(experiment_file(data=missing)))
    touching = {"contact_diffusion": {"config": {"fingertip_contact": True}}}
    with pytest.raises(DataError, match="no public set has poses, joints, commands and tip forces together"):
        plan_cells(read_experiment(experiment_file(models=touching)))


def test_test_episodes_that_a_model_or_a_repair_would_see_are_refused_with_their_ids(experiment_file, tmp_path):
    path = experiment_file()
    dataset = open_dataset(tmp_path / "real")
    split = make_split(dataset)
    swapped = split.model_copy(update={"train": (*split.train[1:], *split.test), "test": split.train[:1]})
    save_split(dataset, swapped, "swapped")
    data = {"sim": {"path": "sim"}, "twin": {"path": "real"}, "real": {"path": "real", "split": "swapped"}}
    for column in ({"sim": "twin"}, {"sim": "sim", "larger": "twin"}, {"sim": "sim", "diagnosed": "twin"}):
        experiment_file(data=data, columns={"single": column | {"real": "real"}})
        with pytest.raises(UsageError, match=f"1 seen: {split.train[0]}"):
            plan_cells(read_experiment(path))
    experiment_file(data=data | {"real": {"path": "real"}}, columns={"single": {"sim": "twin", "real": "real"}})
    plan_cells(read_experiment(path))  # by one split, nothing that is tested on is trained on


def test_only_what_comes_of_a_change_has_another_digest(experiment_file):
    models = {"mlp": TINY, "twin": {"model": "mlp", **TINY}}
    before = plan_cells(read_experiment(experiment_file(models=models)))
    after = plan_cells(read_experiment(experiment_file(models=models | {"twin": {"model": "mlp", **TINY, "steps": 5}})))
    first, second = digests(before.cells), digests(after.cells)
    changed = {name for name in first if first[name] != second[name]}
    assert changed == {name for name in first if "/twin/" in name}
    assert first["train/single/twin/nominal/sim/seed-0"] == first["train/single/mlp/nominal/sim/seed-0"]


def test_a_scene_counts_by_what_it_simulates_and_not_by_what_lies_beside_it(experiment_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    examples = Path(__file__).resolve().parents[2] / "examples" / "elbow_tosses"
    (tmp_path / "lab").mkdir()
    for name in ("scene.yaml", "scene.xml"):
        (tmp_path / "lab" / name).write_bytes((examples / name).read_bytes())
    data = {
        "sim": {"generate": {"scene": "cube_toss", "episodes": 20}},
        "real": {"sealed": SEALED | {"scene": "lab/scene.yaml", "outside": "wind"}},
    }
    path = experiment_file(data=data)
    before = digests(plan_cells(read_experiment(path)).cells)
    (tmp_path / "cube_toss").mkdir()
    for folder in ("lab", "cube_toss"):
        (tmp_path / folder / "notes.txt").write_text("of another day")
    assert digests(plan_cells(read_experiment(path)).cells) == before
    model = tmp_path / "lab" / "scene.xml"
    text = model.read_text()
    model.write_text(text.replace("<worldbody>", '<worldbody><site name="mark" pos="0 0 1"/>', 1))
    changed = digests(plan_cells(read_experiment(path)).cells)
    assert changed["data/real"] != before["data/real"]
    assert changed["data/sim"] == before["data/sim"]
    data["sim"]["generate"]["scene"] = "cube_tos"
    with pytest.raises(UnknownNameError, match="cube_toss"):
        plan_cells(read_experiment(experiment_file(data=data)))


def test_another_mujoco_makes_all_again_that_may_simulate(experiment_file, monkeypatch):
    plan = plan_cells(read_experiment(experiment_file()))
    before = digests(plan.cells)
    monkeypatch.setattr(mujoco, "__version__", "0")
    versions.cache_clear()
    after = digests(plan.cells)
    monkeypatch.undo()
    versions.cache_clear()
    assert all(after[name] != digest for name, digest in before.items())


def test_rows_are_chosen_by_words(experiment_file):
    plan = plan_cells(read_experiment(experiment_file(seeds=[0, 1])))
    chosen = plan.chosen(["seed-1", "sim"])
    assert {(e.regime, e.seed) for e in chosen.entries if e.model} == {("sim", 1)}
    assert not any(name.startswith("train") and "real-finetune" in name for name in chosen.cells)
    with pytest.raises(UnknownNameError, match="did you mean 'seed-1'"):
        plan.chosen(["seed-11"])


def test_words_of_one_kind_are_alternatives_and_rows_of_no_real_episodes_stay_beside(experiment_file):
    changes = {
        "models": {name: TINY | {"model": "mlp"} for name in ("a", "b", "c")},
        "columns": {"single": {"sim": "sim", "real": "real", "scene": "cube_toss"}},
        "rows": ["stays", "repaired simulator"],
        "regimes": ["sim", "real"],
        "real_counts": [0, 2, 3, 4],
    }
    plan = plan_cells(read_experiment(experiment_file(**changes)))
    chosen = plan.chosen(["a", "b", "train-2", "train-4"])
    assert {(entry.model, entry.count) for entry in chosen.entries} == {
        (name, count) for name in ("a", "b", None) for count in (0, 2, 4)
    }
    assert {name for name in chosen.cells if name.startswith("part/")} == {
        "part/real/test",
        "part/real/train-2",
        "part/real/train-4",
    }
    assert {entry.count for entry in plan.chosen(["train-0"]).entries} == {0}
    with pytest.raises(UnknownNameError, match="train-3"):
        plan.chosen(["train-33"])


def test_a_column_is_chosen_with_its_own_rows_alone(experiment_file):
    columns = {title: {"sim": "sim", "real": "real"} for title in ("single", "again")}
    chosen = plan_cells(read_experiment(experiment_file(columns=columns))).chosen(["single"])
    assert {entry.column for entry in chosen.entries} == {"single"}
    assert any(entry.model is None for entry in chosen.entries)


def test_a_repair_needs_a_scene_and_one_object(experiment_file):
    with pytest.raises(CandataError, match="column single has a repair and no scene"):
        plan_cells(read_experiment(experiment_file(rows=["repaired simulator"])))


@pytest.mark.parametrize("name", ["table1", "repair"])
def test_the_papers_experiments_can_be_planned(name, monkeypatch):
    monkeypatch.setattr("candata.experiment.plan.content_digest", lambda path: path)  # objects are fetched elsewhere
    path = Path(__file__).resolve().parents[2] / "examples" / "paper" / f"{name}.yaml"
    plan = plan_cells(read_experiment(path, 0.05)).chosen(["seed-0"])
    kinds = Counter(cell.kind for cell in plan.cells.values())
    assert min(kinds[kind] for kind in ("data", "part", "diagnosis", "train", "evaluation")) > 0
    assert {entry.column for entry in plan.entries} == set(plan.file.columns)
    residual_runs = [c for n, c in plan.cells.items() if n.startswith("train/") and "/sim_residual/repaired/" in n]
    assert residual_runs
    assert all("effects" in cell.inputs for cell in residual_runs)


def test_a_diagnosis_of_test_episodes_of_the_same_world_is_refused(experiment_file, tmp_path):
    (tmp_path / "hidden.yaml").write_text("effects: [{name: object_mass, parameters: {mass_scale: 2.0}}]\n")
    world = {"scene": "cube_toss", "hidden": "hidden.yaml", "world": "one", "train": 4, "test": 4}
    data = {"real": {"sealed": world}, "more": {"sealed": world | {"train": 6, "test": 2}}, "sim": {"path": "sim"}}
    columns = {"single": {"sim": "sim", "real": "real", "diagnosed": "more"}}
    with pytest.raises(UsageError, match="training episodes of more are test episodes of real"):
        read_experiment(experiment_file(data=data, columns=columns))
    data["more"]["sealed"]["seed"] = 7
    read_experiment(experiment_file(data=data, columns=columns))
