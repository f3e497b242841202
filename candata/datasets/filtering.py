"""Choosing episodes by an expression over the catalog, and a dataset of the chosen ones without rewriting data."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from candata.datasets import encode
from candata.datasets.dataset import Dataset
from candata.datasets.deriving import Finish, link_clouds, link_part, new_dataset, nothing_more, publish_first
from candata.datasets.history import derived_lineage
from candata.errors import DataError, MissingExtraError, UnknownNameError, UsageError, Where
from candata.schema.manifest import VersionFile

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

#: Columns an expression may name; `effects` is JSON text. The others tell how the tables lie.
COLUMNS = tuple(name for name in encode.EPISODE_COLUMNS.names if name not in ("row_group", "meta"))

#: Nothing outside the table can be reached: no file, no network, no variable of Python's.
_DATABASE_OPTIONS: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "python_enable_replacements": "false",
    "autoload_known_extensions": "false",
    "autoinstall_known_extensions": "false",
    "lock_configuration": "true",
    "threads": "1",
    "memory_limit": "1GB",
    "temp_directory": "",  # what does not fit is refused, not spilled into the folder the user stands in
}
#: Longest expression [characters], and how many brackets may be open in it: deep nesting keeps the parser busy
#: for minutes, where nothing can stop it.
LIMIT_LENGTH, LIMIT_OPEN = 10_000, 50
#: Kinds of nodes that an expression may hold, as DuckDB's parse tree calls them: no subquery, window, lambda or star.
_KINDS = frozenset(
    ("BETWEEN", "CASE", "CAST", "COLUMN_REF", "COMPARISON", "CONJUNCTION", "CONSTANT", "FUNCTION", "OPERATOR", "TYPE")
)
#: Functions and operators that an expression may call: each tells the same of the same values always, reads nothing
#: else, takes a time that grows with its text, and holds no SQL of its own.
FUNCTIONS = (
    *("+", "-", "*", "/", "//", "%", "abs", "ceil", "floor", "round", "sign", "sqrt", "trunc"),
    *("~~", "!~~", "~~*", "!~~*", "~~~", "like_escape", "not_like_escape", "ilike_escape", "not_ilike_escape"),
    *("||", "concat", "contains", "ends_with", "left", "length", "lower", "ltrim", "prefix", "right", "rtrim"),
    *("starts_with", "strlen", "substr", "substring", "suffix", "trim", "upper"),
    *("regexp_extract", "regexp_full_match", "regexp_matches"),
    *("->", "->>", "json_array_length", "json_contains", "json_extract", "json_extract_string", "json_type"),
    *("array_extract", "len", "list_contains", "list_value"),
)


def matching_ids(dataset: Dataset, expression: str) -> tuple[str, ...]:
    """Return the ids of the episodes for which an expression holds, in the order of the dataset.

    Parameters
    ----------
    dataset : Dataset
        Version to choose from.
    expression : str
        What stands after WHERE in SQL, over `COLUMNS`: `object = 'cup' and rows > 200`.

    Raises
    ------
    UnknownNameError
        When it names no column; lists them and the nearest.
    UsageError
        When it is no single expression that is true or false of an episode, or calls what is not in `FUNCTIONS`: the
        same expression over the same version gives the same episodes always.
    MissingExtraError
        When duckdb is not installed.
    DataError
        When a part is damaged.
    """
    return select(dataset.catalog(_used_columns(expression)), expression)


def _used_columns(expression: str) -> list[str]:
    """Return the columns whose names occur in an expression, and the id: reading all would take most of the time."""
    words = {word.lower() for word in re.findall(r"\w+", expression)}
    return [name for name in COLUMNS if name == "id" or name in words]


def select(catalog: pa.Table, expression: str) -> tuple[str, ...]:
    """Return the ids of the rows of a catalog for which an expression holds; see `matching_ids`.

    Raises
    ------
    UnknownNameError, UsageError, MissingExtraError
        As for `matching_ids`.
    """
    try:
        import duckdb
    except ImportError:
        raise MissingExtraError("duckdb", "query") from None
    _require_short(expression)
    try:
        expression.encode()  # bytes of the command line that are no text come as lone surrogates
        with duckdb.connect(":memory:", config=_DATABASE_OPTIONS) as database:
            _require_expression(database, expression)
            rows = database.from_arrow(catalog).filter(duckdb.SQLExpression(expression)).project("id").fetchall()
    except (duckdb.Error, UnicodeError) as error:
        raise _expression_error(expression, str(error)) from None
    return tuple(row[0] for row in rows)


def _require_short(expression: str) -> None:
    """Refuse what the parser would need minutes for."""
    if len(expression) > LIMIT_LENGTH:
        raise UsageError(
            "the filter is too long", expected=f"at most {LIMIT_LENGTH} characters", found=str(len(expression))
        )
    deepest = max(accumulate((char == "(") - (char == ")") for char in expression), default=0)
    if deepest > LIMIT_OPEN:
        raise _too_deep(str(deepest))


def _require_expression(database: DuckDBPyConnection, expression: str) -> None:
    """Refuse all but one condition over the columns, by what the database's own parser makes of it."""
    try:
        parse_tree = _parse(database, f"select id from catalog where {expression}")
    except RecursionError:
        raise _too_deep() from None
    if parse_tree["error"]:
        raise _expression_error(expression, f"Parser Error: {parse_tree['error_message']}")
    trees = [statement["node"] for statement in parse_tree["statements"]]
    bare = _parse(database, "select id from catalog where true")["statements"][0]["node"]
    condition = trees[0].pop("where_clause", None)
    if len(trees) != 1 or condition is None or trees[0] != {n: v for n, v in bare.items() if n != "where_clause"}:
        raise _expression_error(expression, "more than a condition")
    for node in _nodes(condition):
        kind, name = node["class"], str(node.get("function_name", "")).lower()
        if kind == "COLUMN_REF":
            _require_column(node["column_names"], expression)
        if kind not in _KINDS or (kind == "FUNCTION" and name not in FUNCTIONS):
            raise UsageError(
                f"{name or kind.lower()} has no place in a filter",
                expected="columns compared with values, so that the same episodes are chosen each time",
                found=name or kind.lower(),
                where=Where(path=f"filter {expression[:200]}"),
                fix=f"functions: {', '.join(n for n in FUNCTIONS if n.isidentifier())}; for a part drawn by chance, "
                "the same each time: candata registry split DATASET NAME --seed 3",
            )


def _parse(database: DuckDBPyConnection, statement: str) -> dict[str, Any]:
    """Return the database's parse tree of a statement, or what its parser says against it."""
    ((text,),) = database.execute("select json_serialize_sql(?)", [statement]).fetchall()
    parse_tree: dict[str, Any] = json.loads(text)
    return parse_tree


def _nodes(tree: Any) -> Iterator[dict[str, Any]]:
    """Yield the nodes of a parse tree that have a class."""
    stack = [tree]
    while stack:
        part = stack.pop()
        if isinstance(part, dict) and "class" in part:
            yield part
        if isinstance(part, dict | list):
            stack.extend(part.values() if isinstance(part, dict) else part)


def _require_column(names: Sequence[str], expression: str) -> None:
    """Refuse a name that is no column of the catalog."""
    name = ".".join(names)
    if name.lower() in COLUMNS:
        return
    error = UnknownNameError("column", name, COLUMNS, Where(path=f"filter {expression}"))
    fix = error.fix or f"text stands in single quotes: '{name}'"
    raise UsageError(error.problem, expected=error.expected, found=error.found, where=error.where, fix=fix)


def _too_deep(found: str = "more") -> UsageError:
    """Return the error of an expression that is nested too deep."""
    return UsageError("the filter is nested too deep", expected=f"at most {LIMIT_OPEN} open brackets", found=found)


def _expression_error(expression: str, message: str) -> UsageError:
    """Return what is wrong with an expression, from what the database said."""
    head = message.split("\n", 1)[0].partition(": ")
    return UsageError(
        "the filter is no expression over the catalog",
        expected="one SQL condition, such as: object = 'cup' and rows > 200",
        found=(head[2] or head[0])[:300],
        where=Where(path=f"filter {expression}"),
        fix=f"columns: {', '.join(COLUMNS)}",
    )


def filter_dataset(dataset: Dataset, expression: str, out: Path, finish: Finish = nothing_more) -> VersionFile:
    """Return the version of a new dataset `out` that holds the episodes for which an expression holds.

    Parts are shared with the dataset, not rewritten: what the expression leaves out of a part that is kept still
    lies in it, excluded by the version. The lineage keeps the expression and that of `dataset`.

    Parameters
    ----------
    dataset : Dataset
        Version to choose from.
    expression : str
        Expression, as for `matching_ids`.
    out : Path
        Folder of the new dataset.
    finish : callable
        Takes the new dataset before it appears; `candata.loaders.carry_splits` makes one.

    Raises
    ------
    UnknownNameError, UsageError, MissingExtraError
        As for `matching_ids`, and when `out` stands.
    DataError
        When no episode is left, or a part is damaged.
    """
    chosen_ids = matching_ids(dataset, expression)
    if not chosen_ids:
        raise DataError(
            "no episode is left",
            expected="at least 1",
            found=f"0 of {len(dataset)}",
            where=Where(path=f"filter {expression}"),
            fix="see what there is: candata inspect",
        )
    return chosen_dataset(dataset, chosen_ids, out, {"where": expression}, finish)


def chosen_dataset(
    dataset: Dataset, ids: Sequence[str], out: Path, details: dict[str, Any], finish: Finish = nothing_more
) -> VersionFile:
    """Return the version of a new dataset `out` that holds the episodes with these ids, its parts shared.

    Parameters
    ----------
    dataset : Dataset
        Version to choose from.
    ids : sequence of str
        Episodes; at least one.
    out : Path
        Folder of the new dataset.
    details : dict
        Why these, for the lineage.
    finish : callable
        As for `filter_dataset`.

    Raises
    ------
    UsageError
        When `out` stands.
    DataError
        When no episode is named, the version lacks one, or a part is damaged.
    """
    chosen_ids = frozenset(ids)
    missing_ids = sorted(chosen_ids - set(dataset.ids))
    if missing_ids or not chosen_ids:
        raise DataError(
            "these episodes cannot be chosen",
            expected=f"at least 1 of the {len(dataset)} episodes",
            found=", ".join(missing_ids[:8]) or "none",
            where=Where(path=str(dataset.path)),
        )
    details = details | {"episodes": len(chosen_ids), "of": len(dataset)}
    with new_dataset(out, finish) as root:
        entries, excluded_ids = [], set()
        for part in dataset.raw_parts():
            part_ids = {name for name, _ in part.manifest().episodes}
            if part_ids & chosen_ids:
                entries.append(link_part(part, root))
                excluded_ids |= part_ids - chosen_ids
        link_clouds(dataset, root)
        return publish_first(root, entries, excluded_ids, derived_lineage("filter", [dataset], details))
