"""What the documents show is what happens: examples run as typed, and files they show can be read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from candata.schema.exchange import FeatureMap
from candata.schema.scene import SceneFile, TableMap
from candata.schema.topics import FramesMap, TopicMap
from tests.docs import pages

RECORDS = {record.__name__: record for record in (SceneFile, TableMap, TopicMap, FeatureMap, FramesMap)}
RUN = {"bash": ["bash", "-euo", "pipefail", "-c"], "python": [sys.executable, "-c"]}
RUNNABLE = {*RUN, "yaml"}
#: Documents whose every example is accounted for; examples of `examples/` fetch recordings.
ACCOUNTED = [pages.README, pages.ROOT / "CONTRIBUTING.md", *pages.PAGES]


def parameters(records: bool) -> list[pytest.param]:
    """Return the examples that are records, or the others, with their documents' names."""
    return [
        pytest.param(
            name,
            blocks,
            id=f"{path.relative_to(pages.ROOT)}-{name}",
            marks=[pytest.mark.slow] if any(block.test["slow"] for block in blocks) else [],
        )
        for (path, name), blocks in pages.examples().items()
        if (name in RECORDS) == records
    ]


def play(block: pages.Block, work: Path, shell: dict[str, str]) -> None:
    """Write the block to the file that its tag names, or run it."""
    if block.test["file"]:
        target = work / block.test["file"]
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(block.text, encoding="utf-8")
        return
    done = subprocess.run(
        [*RUN[block.kind], block.text],
        cwd=work,
        env=shell,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{block.text}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize(("name", "blocks"), parameters(records=False))
def test_an_example_runs_as_typed(name, blocks, tmp_path, shell):
    work = tmp_path / "work"
    work.mkdir()
    for block in blocks:
        play(block, work, shell)


@pytest.mark.parametrize(("name", "blocks"), parameters(records=True))
def test_a_file_that_is_shown_is_a_valid_record(name, blocks):
    for block in blocks:
        RECORDS[name].parse(yaml.safe_load(block.text), "the document")


@pytest.mark.parametrize("path", ACCOUNTED, ids=lambda path: path.name)
def test_every_example_runs_or_says_why_not(path):
    untold = [b for b in pages.blocks(path) if b.kind in RUNNABLE and not b.test and not pages.NOT_RUN.match(b.tag)]
    assert [block.text for block in untold] == []
