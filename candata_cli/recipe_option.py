"""The option --recipe: a file that holds the other options of a command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

#: Options that say where and how fast, not what is made; a recipe does not hold them.
_NOT_IN_RECIPES = frozenset(
    {"recipe", "out", "jobs", "shard", "ray", "strict", "dry_run", "json", "again", "episode", "seal", "salt"}
)


def use_recipe(context: typer.Context, path: Path | None) -> Path | None:
    """Take the options of a recipe as defaults of the command; what is typed goes before.

    Keys are options without their dashes (`duration_s` for `--duration-s`). Paths in it are seen from its folder.
    """
    if path is None:
        return None
    from candata.errors import UsageError, Where
    from candata.schema.yaml_text import read_yaml

    values, where = read_yaml(path), Where(path=str(path))
    if not isinstance(values, dict) or not values:
        raise UsageError("the recipe holds no options", expected="a line such as `episodes: 8`", where=where)
    options = {str(p.name): p for p in context.command.params if p.name not in _NOT_IN_RECIPES}
    for name in values:
        if name not in options:
            raise UsageError(
                f"{name} is no option that a recipe may hold", expected=", ".join(sorted(options)), where=where
            )
    context.default_map = {
        **(context.default_map or {}),
        **{name: _plain_value(value, path.parent) for name, value in values.items()},
    }
    return path


def _plain_value(value: Any, folder: Path) -> Any:
    """Return a value as it would be typed: a list as words with commas, shares as NAME:SHARE, a file by its path.

    A folder is meant where its name holds a slash; a bare word may be the name of a scene.
    """
    if isinstance(value, dict):
        return ",".join(f"{name}:{share}" for name, share in value.items())
    if isinstance(value, list):
        return ",".join(str(_plain_value(each, folder)) for each in value)
    if isinstance(value, str):
        name = value.rpartition(":")[0] or value
        is_path = (folder / name).is_file() or ("/" in name and (folder / name).is_dir())
        return f"{folder / name}{value[len(name) :]}" if is_path else value
    return value
