"""`generate-sim --recipe`: a file of options, of which those typed go before."""

from __future__ import annotations

from inspect import signature

import pytest

from candata.datasets import open_dataset
from candata.simulate.recipe import SetRecipe
from candata_cli.generate_commands import generate_sim
from tests.cli.command import run

RECIPE = "scene: cube_toss\nepisodes: 3\nduration_s: 0.2\neffects: sub/heavy.yaml\nnoise: false\n"
HEAVY = "effects:\n  - {name: object_mass, parameters: {mass_scale: 1.5}}\n"


@pytest.fixture
def recipe(tmp_path):
    folder = tmp_path / "recipes"
    (folder / "sub").mkdir(parents=True)
    (folder / "sub" / "heavy.yaml").write_text(HEAVY)
    (folder / "tosses.yaml").write_text(RECIPE)
    return folder / "tosses.yaml"


def test_a_recipe_holds_options_and_files_beside_it(recipe, tmp_path):
    assert run("generate-sim", "--recipe", recipe, "--out", tmp_path / "a").code == 0
    words = (
        "--scene",
        "cube_toss",
        "--duration-s",
        0.2,
        "--effects",
        recipe.parent / "sub" / "heavy.yaml",
        "--no-noise",
    )
    assert run("generate-sim", *words, "--episodes", 3, "--out", tmp_path / "b").code == 0
    first, second = open_dataset(tmp_path / "a"), open_dataset(tmp_path / "b")
    assert first.digest == second.digest
    assert next(iter(first)).meta.effects[0].name == "object_mass"


def test_a_recipe_may_hold_shares_of_outcomes(tmp_path):
    (tmp_path / "set.yaml").write_text("scene: gripper_tabletop\nepisodes: 2\noutcomes: {success: 0.5, fail: 0.4}\n")
    result = run("generate-sim", "--recipe", tmp_path / "set.yaml", "--out", tmp_path / "a")
    assert result.err.startswith("the shares of --outcomes do not sum to 1\n")
    assert "found: 0.9 in success:0.5,fail:0.4\n" in result.err


def test_what_is_typed_goes_before(recipe, tmp_path):
    assert run("generate-sim", "--recipe", recipe, "--episodes", 2, "--out", tmp_path / "a").code == 0
    assert len(open_dataset(tmp_path / "a")) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("episods: 3\n", "episods is no option that a recipe may hold"),
        ("out: elsewhere\n", "out is no option that a recipe may hold"),
        ("shard: 1/2\n", "shard is no option that a recipe may hold"),
        ("- 3\n", "holds no options"),
        ("", "holds no options"),
        ("episodes: many\n", "Invalid value for '--episodes'"),
        ("scene: cube_toss\nepisodes: 1\nduration_s: .nan\n", "duration_s"),
        ("scene: cube_toss\nepisodes: 1\nnoise: false\nnoise_from: a.yaml\n", "no noise and a file of noise at once"),
    ],
)
def test_a_wrong_recipe_is_one_error(tmp_path, text, said):
    (tmp_path / "bad.yaml").write_text(text)
    result = run("generate-sim", "--recipe", tmp_path / "bad.yaml", "--out", tmp_path / "a")
    assert result.code == 2
    assert said in result.err
    assert not (tmp_path / "a").exists()


def test_every_field_of_a_recipe_is_an_option_with_the_same_default():
    options = signature(generate_sim).parameters
    for name, field in SetRecipe.model_fields.items():
        assert name in options
        assert field.is_required() or (options[name].default or None) == (field.default or None)
