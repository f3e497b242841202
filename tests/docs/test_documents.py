"""What the documents say is what the code does: commands run, examples parse, tables and links hold."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
import typer
import yaml

from candata import plugins
from candata.schema import scene
from candata.schema.report import Verdict
from candata_cli.main import build

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("examples/**/*.md")])
README = (ROOT / "README.md").read_text(encoding="utf-8")

#: `<!-- test: NAME [slow] -->` above a fenced block.
BLOCK = re.compile(r"<!-- test: (?P<name>\w+)(?P<slow> slow)? -->\n```(?P<kind>\w+)\n(?P<text>.*?)```", re.DOTALL)


def blocks(kind: str) -> list[pytest.param]:
    """Return (name, text) of the tagged blocks of one kind, in all documents."""
    found = [(path, block) for path in DOCUMENTS for block in BLOCK.finditer(path.read_text(encoding="utf-8"))]
    return [
        pytest.param(
            block["name"],
            block["text"],
            id=f"{path.name}-{block['name']}",
            marks=[pytest.mark.slow] if block["slow"] else [],
        )
        for path, block in found
        if block["kind"] == kind
    ]


def first_column(heading: str) -> set[str]:
    """Return the code words in the first column of the table whose header starts with `heading`."""
    table = README.split(f"\n| {heading} |", 1)[1].split("\n\n", 1)[0]
    return set(re.findall(r"^\| `(\w+)`", table, re.MULTILINE))


@pytest.fixture
def shell(tmp_path):
    """An environment whose `candata` is this checkout's."""
    script = tmp_path / "bin" / "candata"
    script.parent.mkdir()
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m candata_cli.main "$@"\n')
    script.chmod(0o755)
    path = f"{script.parent}{os.pathsep}{os.environ['PATH']}"
    registry = str(tmp_path / "registry.json")
    return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "CANDATA_REGISTRY": registry}


@pytest.mark.parametrize(("name", "commands"), blocks("bash"))
def test_tagged_commands_run(name, commands, tmp_path, shell):
    work = tmp_path / "work"
    work.mkdir()
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", commands],
        cwd=work,
        env=shell,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("record", "text"), blocks("yaml"))
def test_tagged_examples_are_valid_records(record, text):
    getattr(scene, record).parse(yaml.safe_load(text), "README.md")


def test_the_readme_tells_every_verdict():
    assert first_column("verdict") == set(get_args(Verdict))


def test_the_readme_lists_every_effect():
    assert first_column("effect") == set(plugins.names("candata.effects"))


def rows_of(heading: str) -> list[list[str]]:
    """Return the cells of the table whose header starts with `heading`, row by row."""
    table = README.split(f"\n| {heading} |", 1)[1].split("\n\n", 1)[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def test_the_readme_lists_every_format_and_what_it_does():
    told = {name.strip("`"): (bool(read), bool(write), "--v21" in write) for name, read, write in rows_of("format")}
    formats = [plugins.load("candata.formats", "FORMAT", name) for name in plugins.names("candata.formats")]
    assert told == {f.name: (f.read is not None, f.write is not None, "v21" in f.variants) for f in formats}


def test_the_readme_lists_every_command():
    code = " ".join(re.findall(r"`([^`]*)`", " ".join(row[0] for row in rows_of("command"))))
    app = typer.main.get_command(build())
    assert [name for name in app.commands if not re.search(rf"\b{name}\b", code)] == []
    (verbs,) = (row[1] for row in rows_of("command") if "registry VERB" in row[0])
    assert set(verbs.strip("`").split()) == set(app.commands["registry"].commands)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_local_links_lead_somewhere(path):
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)", path.read_text(encoding="utf-8"))
    assert not [link for link in links if not (path.parent / link).exists()]
