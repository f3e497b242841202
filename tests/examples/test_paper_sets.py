"""The recipes of the paper's sets, with the can in place of objects that a user fetches."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from candata.datasets import open_dataset
from candata.schema.yaml_text import read_yaml
from tests.cli.command import run

RECIPES = Path(__file__).parents[2] / "examples" / "paper"


def test_both_recipes_differ_in_objects_number_and_seed_alone():
    mustard, forty = (read_yaml(RECIPES / f"{name}.yaml") for name in ("mustard", "forty"))
    assert mustard.keys() == forty.keys()
    assert {name for name in mustard if mustard[name] != forty[name]} == {"objects", "episodes", "seed"}


def test_a_recipe_makes_episodes_that_differ_and_in_part_fail(tmp_path):
    words = ("--recipe", RECIPES / "mustard.yaml", "--objects", "can", "--episodes", 20, "--out", tmp_path / "set")
    assert run("generate-sim", *words).code == 0
    episodes = list(open_dataset(tmp_path / "set"))
    assert len(episodes) == 20
    assert len({str(e.meta.effects) for e in episodes}) == 20
    assert all(e.meta.kicks for e in episodes)
    outcomes = Counter(e.meta.outcome for e in episodes)
    assert outcomes["success"] >= 4
    assert 20 - outcomes["success"] >= 4


def test_a_recipe_says_what_is_missing_without_the_objects(tmp_path):
    (tmp_path / "paper").mkdir()
    for path in RECIPES.glob("*.yaml"):
        (tmp_path / "paper" / path.name).write_text(path.read_text())
    result = run("generate-sim", "--recipe", tmp_path / "paper" / "mustard.yaml", "--out", tmp_path / "set")
    assert result.code == 2
    assert "mustard_bottle" in result.err
    assert "Traceback" not in result.err
