"""No modules of the library import one another in a circle, not even for types or inside functions."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from tests.architecture.test_layers import LIBRARY, ROOT, modules_imported


def imports() -> dict[str, set[str]]:
    """Return what each module imports; a name from a package counts as its module, or else as the package."""
    dotted_names = {path: ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in LIBRARY}
    modules = {name.removesuffix(".__init__"): path for path, name in dotted_names.items()}
    graph: dict[str, set[str]] = {}
    for module, path in modules.items():
        names = modules_imported(path, ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        targets = {name if name in modules else name.rpartition(".")[0] for name in names}
        graph[module] = targets & modules.keys() - {module}
    return graph


def circle(graph: Mapping[str, set[str]]) -> list[str]:
    """Return the modules of one circle; none where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_modules_import_one_another_in_a_circle():
    graph = imports()
    assert len(graph) == len(LIBRARY)
    assert circle(graph) == []


def test_the_rule_sees_a_circle():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}}) != []
