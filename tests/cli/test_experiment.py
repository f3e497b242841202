"""`candata experiment`: a typo, a forecast that makes nothing, and a table."""

from __future__ import annotations

import json

import yaml

from tests.cli.command import run
from tests.experiment.conftest import small_experiment, standing_set


def test_a_dry_run_tells_hours_and_makes_nothing_and_then_the_table_is_made(tmp_path):
    standing_set(tmp_path, "sim", 6)
    standing_set(tmp_path, "real", 10)
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(small_experiment()))
    arguments = ("experiment", path, "--out", tmp_path / "out", "--only", "sim", "--only", "seed-0,train-0", "--json")
    told = json.loads(run(*arguments, "--dry-run").out)
    assert {cell["kind"] for cell in told["cells"]} == {"data", "part", "train", "evaluation"}
    assert not any(cell["stands"] for cell in told["cells"])
    assert told["hours"] > 0
    assert not (tmp_path / "out").exists()
    made = run(*arguments)
    assert made.code == 0
    assert [row["label"] for row in json.loads(made.out)["rows"]] == ["stays", "mlp, sim"]
    assert json.loads((tmp_path / "out" / "table.json").read_text()) == json.loads(made.out)
    assert (tmp_path / "out" / "table.html").is_file()
    assert all(cell["stands"] for cell in json.loads(run(*arguments, "--dry-run").out)["cells"])


def test_a_typo_is_named_before_anything_is_made(tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(small_experiment() | {"seed": [0]}))
    refused = run("experiment", path, "--out", tmp_path / "out")
    assert refused.code == 2
    assert refused.err.startswith("small.yaml is not valid: unknown key `seed`, did you mean `seeds`")
    assert not (tmp_path / "out").exists()
