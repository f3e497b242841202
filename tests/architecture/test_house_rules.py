"""Rules of the house that a reader would otherwise have to check by eye."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = sorted((ROOT / "candata").rglob("*.py"))
SOURCE = LIBRARY + sorted((ROOT / "candata_cli").rglob("*.py"))

MODULE_LINES = 400
FUNCTION_LINES = 60
#: Modules that read JSON without bounds: what own processes and episodes say, DuckDB's parse tree, a script's text.
UNBOUNDED = {
    *("checks/defects.py", "datasets/filtering.py", "record/reader.py", "record/reader_link.py", "repair/script.py"),
    *("reports/offscreen.py", "scenes/first_load.py", "schema/json_text.py", "schema/yaml_text.py"),
}
#: Modules that rename files over others: the one atomic write, a link that leads to a port, a trial of the disk, and
#: a pull, which syncs its folders once when all files have come.
REPLACING = {"datasets/durable.py", "datasets/probe.py", "datasets/pull.py", "record/emulate_line.py"}
PICKLES = {"pickle", "cPickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def ids(paths: list[Path]) -> list[str]:
    return [str(path.relative_to(ROOT)) for path in paths]


def code_lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function without its docstring."""
    total = (node.end_lineno or node.lineno) - node.lineno + 1
    first = node.body[0]
    if ast.get_docstring(node) is not None:
        total -= (first.end_lineno or first.lineno) - first.lineno + 1
    return total


def public(body: list[ast.stmt]) -> Iterator[Definition]:
    """Public functions and classes, and the public methods of those classes."""
    for node in body:
        if isinstance(node, Definition) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from public(node.body)


def imported_roots(tree: ast.Module) -> set[str]:
    names = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    return {name.split(".")[0] for name in names}


@pytest.mark.parametrize("path", SOURCE, ids=ids(SOURCE))
def test_lengths(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MODULE_LINES
    functions = [n for n in ast.walk(tree_of(path)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    long = {node.name: code_lines(node) for node in functions if code_lines(node) > FUNCTION_LINES}
    assert not long


@pytest.mark.parametrize("path", SOURCE, ids=ids(SOURCE))
def test_everything_public_has_a_docstring(path):
    tree = tree_of(path)
    assert ast.get_docstring(tree) or not tree.body, "the module says nothing of itself"
    assert not [node.name for node in public(tree.body) if not ast.get_docstring(node)]


def replaces_files(path: Path) -> bool:
    """Whether a module calls `os.replace(draft, path)` or `draft.replace(path)`; texts and records take two values."""
    calls = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)]
    return any(
        ast.unparse(node.func) == "os.replace"
        or (
            (isinstance(node.func, ast.Attribute) and node.func.attr == "replace" and not node.keywords)
            and len(node.args) == 1
        )
        for node in calls
    )


def test_files_are_replaced_in_one_place():
    assert {str(path.relative_to(ROOT / "candata")) for path in LIBRARY if replaces_files(path)} == REPLACING


@pytest.mark.parametrize("path", SOURCE, ids=ids(SOURCE))
def test_no_pickle(path):
    tree = tree_of(path)
    assert not imported_roots(tree) & PICKLES
    keywords = [node for node in ast.walk(tree) if isinstance(node, ast.keyword) and node.arg == "allow_pickle"]
    assert all(isinstance(node.value, ast.Constant) and node.value.value is False for node in keywords)


@pytest.mark.parametrize("path", SOURCE, ids=ids(SOURCE))
def test_no_assert_validates(path):
    assert not [node.lineno for node in ast.walk(tree_of(path)) if isinstance(node, ast.Assert)]


@pytest.mark.parametrize("path", LIBRARY, ids=ids(LIBRARY))
def test_the_library_prints_nothing(path):
    calls = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)]
    assert not [call.lineno for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"]


@pytest.mark.parametrize("path", SOURCE, ids=ids(SOURCE))
def test_texts_of_users_are_read_within_bounds(path):
    calls = re.findall(r"\b(?:json\.loads?|yaml\.(?:safe_)?load)\(", path.read_text(encoding="utf-8"))
    assert not calls or path in [ROOT / "candata" / name for name in UNBOUNDED]
