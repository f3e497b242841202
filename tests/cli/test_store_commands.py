from __future__ import annotations

import json
import os
import time

import pytest
import typer
from typer.testing import CliRunner

from candata.datasets import append, create_dataset, migrate, open_dataset, write_part
from candata.errors import DataError, UsageError
from candata.schema.manifest import Lineage
from candata_cli.store_commands import register, seconds

app = typer.Typer()
register(app)


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture
def root(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode(f"e{i}", seed=i) for i in range(3)], Lineage(operation="test"), part_size=1)
    return root


def age(root, days=30.0):
    for path in [root, *root.rglob("*")]:
        os.utime(path, (time.time() - days * 86_400,) * 2)


def test_compact_says_what_it_did(root):
    result = run("compact", root)
    assert (result.exit_code, result.stdout) == (0, "version 2: 3 parts are 1 now\n")
    assert run("compact", root).stdout == "nothing to do: version 2 has 1 part\n"


def test_compact_json(root):
    digest = open_dataset(root).digest
    assert json.loads(run("compact", root, "--json").stdout) == {
        "version": 2,
        "digest": digest,
        "parts_before": 3,
        "parts_after": 1,
        "left_out": 0,
    }


def test_gc_removes_says_and_counts(root, episode):
    run("compact", root)
    age(root)
    part = write_part(root, [episode("young", seed=9)], {})
    told = run("gc", root, "--keep", 1, "--dry-run").stdout
    assert len(list((root / "parts").iterdir())) == 5
    done = run("gc", root, "--keep", 1).stdout
    assert told == done.replace("freed", "would free")
    lines = done.splitlines()
    assert [line.split()[0] for line in lines] == ["what", "version", "part", "part", "part", "freed", "1"]
    assert lines[-2].endswith("bytes in 4 things")
    assert lines[-1] == "1 thing more out of reach, but changed within the last 7d"
    assert {p.name for p in (root / "parts").iterdir()} == {part.id, open_dataset(root).file.parts[0].id}


def test_gc_json(root):
    run("compact", root)
    age(root)
    found = json.loads(run("gc", root, "--keep", 1, "--json").stdout)
    assert list(found) == ["dry_run", "bytes", "removed", "waiting", "notes"]
    assert [one["kind"] for one in found["removed"]] == ["version", "part", "part", "part"]
    assert found["bytes"] == sum(one["bytes"] for one in found["removed"]) > 0
    assert run("gc", root).stdout == "freed 0 bytes in 0 things\n"


def test_gc_notes_go_to_stderr(root):
    from candata.datasets import put_cloud

    put_cloud(root, [[0.0, 0.0, 0.0]])
    next(root.glob("parts/*/episodes.parquet")).write_bytes(b"")
    result = run("gc", root)
    assert "point clouds stay" in result.stderr
    assert "point clouds" not in result.stdout


@pytest.mark.parametrize("text", ["7", "d", "-1d", "1w", "1 d", ""])
def test_what_is_no_duration_is_refused(root, text):
    result = run("gc", root, f"--grace={text}")
    assert isinstance(result.exception, UsageError)
    assert "such as 7d" in str(result.exception)


def test_durations():
    assert [seconds(text) for text in ("30s", "1.5m", "12h", "7d")] == [30.0, 90.0, 43_200.0, 604_800.0]


def test_migrate_of_the_present_format(root, tmp_path):
    result = run("migrate", root, "--out", tmp_path / "new")
    assert (result.exit_code, result.stdout) == (0, f"nothing to do: {root} has the present format, 1\n")
    found = json.loads(run("migrate", root, "--out", tmp_path / "new", "--json").stdout)
    assert found == {"from": 1, "to": 1, "out": None}


def test_migrate_of_an_older_format(root, tmp_path, monkeypatch):
    path = root / "dataset.json"
    path.write_text(path.read_text().replace('"format_version": 1', '"format_version": 0'))

    def step(draft):
        inside = draft / "dataset.json"
        inside.write_text(inside.read_text().replace('"format_version": 0', '"format_version": 1'))

    real = migrate.migrate_dataset
    monkeypatch.setattr(migrate, "migrate_dataset", lambda old, new: real(old, new, steps={0: step}))
    new = tmp_path / "new"
    assert run("migrate", root, "--out", new).stdout == f"{new}: format 1, from format 0\n"
    assert len(open_dataset(new)) == 3
    assert isinstance(run("migrate", root, "--out", new).exception, UsageError)


@pytest.mark.parametrize("command", ["compact", "gc", "migrate"])
def test_no_dataset_is_an_error(tmp_path, command):
    options = ["--out", tmp_path / "new"] if command == "migrate" else []
    assert isinstance(run(command, tmp_path, *options).exception, UsageError)


def test_compact_of_an_empty_dataset_is_an_error(tmp_path):
    assert isinstance(run("compact", create_dataset(tmp_path / "ds")).exception, DataError)
