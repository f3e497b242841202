"""The command that lists what there is to choose from, built in and from other packages: list."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata.errors import MissingExtraError

if TYPE_CHECKING:
    from candata.plugins import Registry

_EXAMPLE = """\b
Examples:
  candata list
  candata list effects
"""
Kind = Annotated[
    str | None,
    typer.Argument(
        metavar="KIND", help="effects, models, formats, devices, policies, scenes, objects or checks [all]."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def register(app: typer.Typer) -> None:
    """Add `list`."""
    app.command("list", epilog=_EXAMPLE)(list_plugins)


def list_plugins(kind: Kind = None, json: Json = False) -> None:
    """List effects, models, formats, devices, policies, scenes, objects and checks, and the package each comes from.

    What another package brings and cannot be used is said on stderr, with exit code 3.
    """
    from candata.plugins import REGISTRIES, registry
    from candata_cli.console import note, out_json, out_table

    registries = [registry(name) for name in ([kind] if kind else sorted(REGISTRIES))]
    problems = [problem for plugins in registries for problem in plugins.problems()]
    rows = [row for plugins in registries for row in _rows(plugins, {problem.name for problem in problems})]
    if json:
        out_json(rows)
    else:
        out_table(("kind", "name", "package", "about"), [tuple(row.values()) for row in rows])
    for problem in problems:
        note(str(problem))
    if problems:
        raise typer.Exit(problems[0].exit_code)


def _rows(plugins: Registry[Any], broken_names: set[str]) -> list[dict[str, str]]:
    """Return a row for each plug-in of one kind that can be used, or only lacks a package of an extra."""
    rows = []
    for name in plugins.names():
        origin = plugins.origin(name)
        if name in broken_names and origin != "candata":
            continue
        try:
            summary = str(getattr(plugins.load(name), plugins.summary))
        except MissingExtraError as error:
            summary = f"{error.problem}: {error.fix}"
        rows.append({"kind": plugins.kind, "name": name, "package": origin, "about": summary})
    return rows
