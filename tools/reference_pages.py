"""The reference of the site, written from the code: commands, Python, effects, formats and file schemas.

    python tools/reference_pages.py FOLDER

writes the pages into a folder; `site_pages` puts them on the site.
"""

from __future__ import annotations

import inspect
import json
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

import candata
from candata import errors, plugins, testing
from candata.effects import EFFECTS, Parameter
from candata.formats import FORMATS
from candata.scenes import load_scene
from candata.schema.export import documents as schema_documents
from candata_cli.main import build

#: Scene in which the ranges of effects are shown.
SCENE = "xhand_tabletop"
#: What plug-ins are made of, beside the classes of the registries; those of devices have two.
CONTRACTS = (
    "candata.record.devices.Device",
    "candata.record.devices.StreamDevice",
    "candata.effects.Parameter",
    "candata.effects.Forces",
    "candata.effects.Servos",
    "candata.formats.Reading",
    "candata.formats.Writing",
)


def documents() -> dict[str, str]:
    """Return the text of each page by its name."""
    return {
        "commands.md": commands_page(),
        "python.md": python_page(),
        "effects.md": effects_page(),
        "formats.md": formats_page(),
        "schemas.md": schemas_page(),
    }


def rows(head: tuple[str, ...], body: list[tuple[str, ...]]) -> str:
    """Return a Markdown table; bars and line ends inside cells are made harmless."""
    lines = [[" ".join(str(cell).split()).replace("|", "\\|") for cell in row] for row in body]
    return "\n".join(f"| {' | '.join(row)} |" for row in [list(head), ["---"] * len(head), *lines])


def commands_page() -> str:
    """Return the page of all commands with their options."""
    parts = ["# Every command and option", "What `--help` prints, for reading and searching."]
    for words, command in leaves(typer.main.get_command(build())):
        arguments = [_argument(param) for param in command.params if param.param_type_name == "argument"]
        usage = " ".join([*arguments, "[OPTIONS]"])
        parts += [f"## candata {words}", plain(command.help or ""), f"```text\ncandata {words} {usage}\n```"]
        parts += [f"```text\n{plain(command.epilog)}\n```"] if command.epilog else []
        parts.append(rows(("option", "meaning", "default"), [option_row(param) for param in command.params]))
    return "\n\n".join(parts) + "\n"


def leaves(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield the words and the command of every command that runs."""
    for name, child in sorted(command.commands.items()):
        if hasattr(child, "commands"):
            yield from leaves(child, (*words, name))
        else:
            yield " ".join((*words, name)), child


def option_row(param: Any) -> tuple[str, ...]:
    """Return names, meaning and default of an option or argument."""
    if param.param_type_name == "argument":
        names = f"`{_argument(param)}`"
    else:
        names = ", ".join(f"`{opt}`" for opt in [*param.opts, *param.secondary_opts])
    default = "required" if param.required else _default(param.default)
    # The default number of processes is that of this machine's cores.
    return names, getattr(param, "help", "") or "", "cores" if "--jobs" in param.opts else default


def _default(value: Any) -> str:
    """Return a default as code; an option that is off or not given has none."""
    return "" if value is None or value is False or value in ((), "") else f"`{value}`"


def _argument(param: Any) -> str:
    """Return how an argument is written in a usage line."""
    name = param.metavar or param.name.upper()
    return f"{name}..." if param.nargs == -1 else name


def plain(text: str | None) -> str:
    """Return help text without click's marks."""
    return inspect.cleandoc((text or "").replace("\b", "")).strip()


def python_page() -> str:
    """Return the page of the public Python names, the contracts of plug-ins and the errors."""
    homes = [f"{candata._HOMES[name]}.{name}" for name in candata.__all__]
    contracts = [_dotted(plugins.registry(kind).contract) for kind in sorted(plugins.REGISTRIES) if kind != "devices"]
    suites = [(f"`{name}`", plain(getattr(testing, name).__doc__).split("\n")[0]) for name in testing.__all__]
    kinds = [
        (f"`{name}`", str(kind.exit_code), plain(kind.__doc__).split("\n")[0])
        for name, kind in sorted(vars(errors).items())
        if inspect.isclass(kind) and issubclass(kind, errors.CandataError)
    ]
    parts = [
        "# Python",
        "`import candata` gives the names of the first section. Arrays are SI; quaternions are w x y z.",
    ]
    parts += ["## Public names", *(f"::: {home}" for home in homes)]
    parts += ["## Contracts of plug-ins", *(f"::: {name}" for name in [*contracts, *CONTRACTS] if name not in homes)]
    parts += ["## Suites for tests of plug-ins", "All lie in `candata.testing`.", rows(("suite", "what it is"), suites)]
    parts += ["## Errors", "All lie in `candata.errors`.", rows(("error", "exit code", "when"), kinds)]
    return "\n\n".join(parts) + "\n"


def _dotted(contract: Any) -> str:
    """Return the dotted name of a class, by its public room rather than its private module."""
    return f"{re.sub(r'[.]_[^.]*$', '', contract.__module__)}.{contract.__name__}"


def effects_page() -> str:
    """Return the page of all effects: what each changes, its numbers, their ranges and where these come from."""
    scene = load_scene(SCENE)
    parts = [
        "# Every effect in numbers",
        f"Ranges depend on the scene; those shown are of the built-in `{SCENE}`. An effect vanishes at its neutral"
        " value. Where there is none, it replaces the model's own number. [Effects](../effects.md) says how to use it.",
    ]
    head = ("parameter", "unit", "range", "neutral", "source of the range")
    for name, effect in EFFECTS.load_all().items():
        body = [(f"`{p.name}`", p.unit, _range(p, scene), _neutral(p, scene), p.source) for p in effect.parameters]
        parts += [f"## {name}", f"{effect.about[0].upper()}{effect.about[1:]}. Acts on: {effect.acts_on}."]
        parts += [rows(head, body)] if body else []
    return "\n\n".join(parts) + "\n"


def _range(parameter: Parameter, scene: Any) -> str:
    """Return the range of a parameter in a scene, or its words."""
    if parameter.choices:
        return ", ".join(parameter.choices)
    low, high = parameter.bounds(scene)
    return f"{low:.3g} to {high:.3g}"


def _neutral(parameter: Parameter, scene: Any) -> str:
    """Return the value at which the effect vanishes."""
    value = parameter.identity(scene)
    return "" if math.isnan(value) else f"{value:g}"


def formats_page() -> str:
    """Return the page of the foreign formats."""
    body = [
        (
            f"`{name}`",
            kind.summary,
            "yes" if kind.read else "no",
            "yes" if kind.write else "no",
            "yes" if kind.takes_map else "no",
            ", ".join(kind.variants),
        )
        for name, kind in FORMATS.load_all().items()
    ]
    head = ("format", "what it is", "import", "export", "takes `--map`", "older layouts")
    return f"# Formats\n\n[Importing](../importing.md) shows how to use them.\n\n{rows(head, body)}\n"


def schemas_page() -> str:
    """Return the page of the file schemas: each file, its fields, and its JSON Schema to download."""
    parts = ["# File schemas", "Files that candata reads and writes, each with its JSON Schema (draft 2020-12)."]
    for name, text in schema_documents().items():
        schema = json.loads(text)
        if isinstance(schema, list):
            body = [
                (f"`{row['name']}`", row["unit"], _shape(row["shape"]), row["role"], row["meaning"]) for row in schema
            ]
            head = ("channel", "unit", "shape", "role", "meaning")
            parts += ["## Channels", "[channels.json](../schemas/channels.json)", rows(head, body)]
            continue
        if "$ref" in schema:
            schema = schema["$defs"][_type(schema)]
        parts += [f"## {schema['title']}", f"[{name}](../schemas/{name}). {plain(schema.get('description'))}"]
        required = schema.get("required", [])
        body = [
            (f"`{key}`", _type(value), "yes" if key in required else "no", value.get("description", ""))
            for key, value in schema.get("properties", {}).items()
        ]
        parts.append(rows(("field", "type", "required", "meaning"), body))
    return "\n\n".join(parts) + "\n"


def _shape(axes: list[str | int]) -> str:
    """Return the shape of a channel as it is written: (T, 7)."""
    return f"({', '.join(map(str, axes))})"


def _type(value: dict[str, Any]) -> str:
    """Return the type of a field of a JSON Schema in words."""
    if "$ref" in value:
        return str(value["$ref"]).rsplit("/", 1)[-1]
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(_type(option) for option in value["anyOf"]))
    if "enum" in value or "const" in value:
        return ", ".join(f"`{word}`" for word in value.get("enum", [value.get("const")]))
    if value.get("type") == "array" and "items" in value:
        return f"list of {_type(value['items'])}"
    return str(value.get("type", "any"))


if __name__ == "__main__":
    for page_name, page_text in documents().items():
        (Path(sys.argv[1]) / page_name).write_text(page_text, encoding="utf-8")
