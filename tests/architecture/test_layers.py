"""A room imports only from the rooms above it; nothing sees the command line."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

#: Rooms from the top down; rooms of one row are of one level.
LAYERS = (
    ("errors", "units", "plugins", "rotation", "lfs", "user_folders", "statistics"),
    ("schema",),
    ("align",),
    ("datasets",),
    ("formats",),
    ("fetch",),
    ("hub",),
    ("scenes",),
    ("effects",),
    ("policies",),
    ("simulate",),
    ("record",),
    ("loaders",),
    ("models",),
    ("training",),
    ("gap",),
    ("checks",),
    ("repair",),
    ("experiment",),
    ("policy_evaluation",),
    ("reports",),
    ("plot",),
    ("testing",),
)
LEVEL = {room: level for level, rooms in enumerate(LAYERS) for room in rooms}

#: Rooms of the diagnosis from the top down: folders, and the two modules that call them.
DIAGNOSIS = (
    *("run", "data", "replay", "measure", "fit", "mismatch", "screening", "preparation", "moves", "force", "search"),
    *("validation", "verdict", "diagnosis", "blind"),
)
#: Most rooms of the diagnosis that import one another in a row.
FLOORS = 12

LIBRARY = sorted((ROOT / "candata").rglob("*.py"))
COMMANDS = sorted((ROOT / "candata_cli").rglob("*.py"))

#: What a command file may import before a command runs, beside the standard library.
LIGHT = {"typer", "candata_cli", "candata.errors"}


def modules_imported(path: Path, nodes: Iterator[ast.AST]) -> Iterator[str]:
    """Yield the dotted names that `nodes` import, relative imports resolved, `from a import b` as `a.b`."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = ".".join([*base, *filter(None, [node.module])])
            yield from (f"{stem}.{alias.name}" for alias in node.names)


def top_level(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield what runs at import: bodies of functions and of `if TYPE_CHECKING` are emptied."""
    for node in ast.walk(tree):
        types_only = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        if types_only or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = []
    yield from ast.walk(tree)


def room_of(path: Path) -> str:
    """Return the room of a file of the library; the package's own file has none."""
    first = path.relative_to(ROOT / "candata").parts[0]
    return first.removesuffix(".py")


def ids(paths: list[Path]) -> list[str]:
    return [str(path.relative_to(ROOT)) for path in paths]


def room_files() -> list[Path]:
    return [path for path in LIBRARY if room_of(path) != "__init__"]


@pytest.mark.parametrize("path", room_files(), ids=ids(room_files()))
def test_a_room_imports_only_from_rooms_above(path):
    room = room_of(path)
    assert room in LEVEL, f"{room} is no room of the design: give it a layer in LAYERS"
    for name in modules_imported(path, ast.walk(ast.parse(path.read_text(encoding="utf-8")))):
        parts = name.split(".")
        if name == "candata.__version__" or parts[0] != "candata":
            assert parts[0] != "candata_cli", f"{name}: the library must not see the command line"
            continue
        assert parts[1] in LEVEL, f"{name}: import from the room, not the public surface"
        allowed = parts[1] == room or LEVEL[parts[1]] < LEVEL[room] or LEVEL[room] == 0 == LEVEL[parts[1]]
        assert allowed, f"{room} is above {parts[1]} and must not import {name}"


def imported_rooms(path: Path) -> set[str]:
    """Return the rooms of the diagnosis that a file of it imports, its own among them."""
    names = modules_imported(path, ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    return {name.split(".")[2] for name in names if name.startswith("candata.gap.")}


def diagnosis_files() -> list[tuple[str, Path]]:
    """Return the files of the diagnosis, each with its room; its public surface has none."""
    files = (ROOT / "candata/gap").rglob("*.py")
    rooms = [(path.relative_to(ROOT / "candata/gap").parts[0].removesuffix(".py"), path) for path in sorted(files)]
    return [(room, path) for room, path in rooms if room != "__init__"]


@pytest.mark.parametrize(("room", "path"), diagnosis_files(), ids=ids([path for _, path in diagnosis_files()]))
def test_a_room_of_the_diagnosis_imports_only_from_rooms_above(room, path):
    allowed = set(DIAGNOSIS[: DIAGNOSIS.index(room) + 1])
    assert imported_rooms(path) - allowed == set(), f"{room} is above them in DIAGNOSIS"


def test_few_rooms_of_the_diagnosis_stand_on_one_another():
    floor = dict.fromkeys(DIAGNOSIS, 1)
    for room in DIAGNOSIS:
        below = {name for own, path in diagnosis_files() if own == room for name in imported_rooms(path)} - {room}
        floor[room] = 1 + max((floor[name] for name in below), default=0)
    assert max(floor.values()) <= FLOORS


def test_a_folder_of_the_diagnosis_says_in_one_line_what_it_does():
    for path in (ROOT / "candata/gap").glob("*/__init__.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if path.parent.name != "moves":  # a registry
            assert len(tree.body) == 1, f"{path.parent.name}: import from the module"
        assert "\n" not in (ast.get_docstring(tree) or "\n").split("\n\n")[0]


@pytest.mark.parametrize("path", COMMANDS, ids=ids(COMMANDS))
def test_a_command_file_imports_nothing_heavy_before_a_command_runs(path):
    light = LIGHT | set(sys.stdlib_module_names)
    for name in modules_imported(path, top_level(ast.parse(path.read_text(encoding="utf-8")))):
        known = name.split(".")[0] in light or any(name.startswith(f"{module}.") for module in light)
        assert known, f"import {name} inside the command that needs it"


def rooms_listed(heading: str) -> list[tuple[str, ...]]:
    """Return the rooms of each row of a table of the architecture."""
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rows = text.split(f"\n| {heading} |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [tuple(re.findall(r"`(\w+)`", row.split("|")[1])) for row in rows]


def test_the_architecture_lists_the_rooms_from_the_top_down():
    assert rooms_listed("room") == list(LAYERS)


def test_the_architecture_lists_the_rooms_of_the_diagnosis_from_the_top_down():
    assert rooms_listed("room of `gap`") == [(room,) for room in DIAGNOSIS]


def test_the_rule_sees_a_wrong_import():
    tree = ast.parse("def f():\n    from candata.gap import fit\n")
    assert list(modules_imported(ROOT / "candata/effects/x.py", ast.walk(tree))) == ["candata.gap.fit"]
