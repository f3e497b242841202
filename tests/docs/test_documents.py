"""What the documents say is what the code does: commands run, examples parse, tables and links hold."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
import yaml

from candata import plugins
from candata.schema import scene
from candata.schema.report import Verdict

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


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_local_links_lead_somewhere(path):
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)", path.read_text(encoding="utf-8"))
    assert not [link for link in links if not (path.parent / link).exists()]
