from __future__ import annotations

import json

import pytest
import typer
from typer.testing import CliRunner

from candata.datasets import append, create_dataset
from candata.errors import DataError, UsageError
from candata.schema.manifest import Lineage
from candata_cli.dataset_commands import register

app = typer.Typer(callback=lambda: None)
register(app)


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture
def root(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    episodes = [episode(f"e{i}", seed=i, rows=40, object="cup") for i in range(3)]
    append(root, [*episodes, episode("r", source="real", contact=False)], Lineage(operation="test"))
    return root


def damage(root):
    path = max(root.glob("parts/*/steps.parquet"), key=lambda p: p.stat().st_size)
    data = path.read_bytes()
    path.write_bytes(data[:1000] + bytes([data[1000] ^ 0xFF]) + data[1001:])


def test_validate_says_one_line_when_all_is_well(root):
    result = run("validate", root)
    assert (result.exit_code, result.stdout) == (0, "4 episodes, no findings\n")


def test_validate_prints_a_table_and_exits_1_on_an_error(root):
    damage(root)
    result = run("validate", root)
    assert result.exit_code == 1
    assert "hashes" in result.stdout
    assert "steps.parquet: sha256" in result.stdout


def test_validate_json(root):
    sound = json.loads(run("validate", root, "--json").stdout)
    assert (sound["dataset"], sound["episodes"], sound["findings"]) == ("ds", 4, [])
    damage(root)
    result = run("validate", root, "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["findings"][0]["rule"] == "hashes"


def test_validate_of_doubtful_data_exits_0(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("a", rate_hz=100.0)], Lineage(operation="test"))
    result = run("validate", root)
    assert result.exit_code == 0
    assert "warning" in result.stdout


def test_no_dataset_and_an_empty_one_are_errors(tmp_path):
    assert isinstance(run("validate", tmp_path / "none").exception, UsageError)
    assert isinstance(run("validate", create_dataset(tmp_path / "ds")).exception, DataError)


def test_an_older_version_can_be_looked_at(root, episode):
    append(root, [episode("later", seed=9)], Lineage(operation="more"))
    assert run("validate", root, "--version", "1").stdout == "4 episodes, no findings\n"
    assert run("validate", root).stdout == "5 episodes, no findings\n"
