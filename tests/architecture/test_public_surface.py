"""The public surface, name by name: adding or losing one is a decision."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

import candata

ROOT = Path(__file__).resolve().parents[2]
ROOMS = sorted(path.parent for path in (ROOT / "candata").rglob("__init__.py"))
PUBLIC = ["Effect", "Episode", "Scene", "diagnose", "load_scene", "open_dataset", "rollout", "windows"]


def test_the_public_names():
    assert sorted(candata.__all__) == PUBLIC
    assert set(dir(candata)) == {*PUBLIC, "__version__"}


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_leads_to_its_room(name):
    assert getattr(candata, name).__name__ == name


@pytest.mark.parametrize("name", PUBLIC)
def test_no_public_name_hides_a_module(name):
    assert importlib.util.find_spec(f"candata.{name}") is None


@pytest.mark.parametrize("room", ROOMS, ids=[str(room.relative_to(ROOT)) for room in ROOMS])
def test_no_re_exported_name_hides_a_file_of_its_room(room):
    tree = ast.parse((room / "__init__.py").read_text(encoding="utf-8"))
    bound = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    bound |= {a.asname or a.name for n in tree.body if isinstance(n, ast.ImportFrom) for a in n.names}
    assert not bound & {path.stem for path in room.glob("*.py")}


def test_another_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        candata.nothing  # noqa: B018


def test_windows_is_refused_in_one_sentence():
    code = "import sys; sys.platform = 'win32'; import candata"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "candata runs on Linux and macOS; Windows is not supported" in done.stderr.splitlines()[-1]
