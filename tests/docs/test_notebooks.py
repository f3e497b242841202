"""The notebooks of the documents run from the first cell to the last, and show what they say."""

from __future__ import annotations

import nbformat
import pytest
from nbclient import NotebookClient

from tests.docs import pages


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of Jupyter's event loop, not of candata
@pytest.mark.parametrize("path", pages.NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_runs(path, tmp_path, shell, monkeypatch):
    for name in ("PATH", "PYTHONPATH", "CANDATA_REGISTRY"):
        monkeypatch.setenv(name, shell[name])
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    text = "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", []))
    assert "verdict: explained" in text
    assert "joint_dry_friction on left_end" in text


@pytest.mark.parametrize("path", pages.NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_kept_as_it_ran(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert [output for cell in cells for output in cell.outputs if output.output_type == "error"] == []
