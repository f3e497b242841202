"""Choosing episodes by an expression over the catalog, and a dataset of the chosen ones without rewriting data."""

from __future__ import annotations

import re
from pathlib import Path

import pyarrow as pa

from candata.datasets import encode
from candata.datasets.dataset import Dataset
from candata.datasets.deriving import link_clouds, link_part, new_dataset, publish_first
from candata.datasets.history import derived
from candata.errors import DataError, MissingExtraError, UnknownNameError, UsageError, Where
from candata.schema.manifest import VersionFile

#: Columns an expression may name; `effects` is JSON text. The others tell how the tables lie.
COLUMNS = tuple(name for name in encode.EPISODE_COLUMNS.names if name not in ("row_group", "meta"))

#: Nothing outside the table can be reached: no file, no network, no variable of Python's.
_CLOSED: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "python_enable_replacements": "false",
    "autoload_known_extensions": "false",
    "autoinstall_known_extensions": "false",
    "lock_configuration": "true",
    "threads": "1",
}


def matching(dataset: Dataset, where: str) -> tuple[str, ...]:
    """Return the ids of the episodes for which an expression holds, in the order of the dataset.

    Parameters
    ----------
    dataset : Dataset
        Version to choose from.
    where : str
        What stands after WHERE in SQL, over `COLUMNS`: `object = 'cup' and rows > 200`.

    Raises
    ------
    UnknownNameError
        When it names no column; lists them and the nearest.
    UsageError
        When it is no single expression that is true or false of an episode.
    MissingExtraError
        When duckdb is not installed.
    DataError
        When a part is damaged.
    """
    return select(dataset.catalog(_named(where)), where)


def _named(where: str) -> list[str]:
    """Return the columns whose names occur in an expression, and the id: reading all would take most of the time."""
    words = {word.lower() for word in re.findall(r"\w+", where)}
    return [name for name in COLUMNS if name == "id" or name in words]


def select(catalog: pa.Table, where: str) -> tuple[str, ...]:
    """Return the ids of the rows of a catalog for which an expression holds; see `matching`.

    Raises
    ------
    UnknownNameError, UsageError, MissingExtraError
        As for `matching`.
    """
    try:
        import duckdb
    except ImportError:
        raise MissingExtraError("duckdb", "query") from None
    database = duckdb.connect(":memory:", config=_CLOSED)
    try:
        kept = database.from_arrow(catalog).filter(duckdb.SQLExpression(where)).project("id")
        return tuple(row[0] for row in kept.fetchall())
    except (duckdb.Error, UnicodeError) as error:
        raise _wrong(where, str(error)) from None
    finally:
        database.close()


def _wrong(where: str, said: str) -> UsageError:
    """Return what is wrong with an expression, from what the database said."""
    unknown = re.search(r'Referenced (?:column|table) "(.*?)" not found', said)
    if unknown:
        known = UnknownNameError("column", unknown[1], COLUMNS, Where(path=f"filter {where}"))
        quotes = f"text stands in single quotes: '{unknown[1]}'"
        return known if known.fix else UsageError(
            known.problem, expected=known.expected, found=known.found, where=known.where, fix=quotes
        )  # fmt: skip
    first = said.split("\n", 1)[0].partition(": ")
    return UsageError(
        "the filter is no expression over the catalog",
        expected="one SQL condition, such as: object = 'cup' and rows > 200",
        found=(first[2] or first[0])[:300],
        where=Where(path=f"filter {where}"),
        fix=f"columns: {', '.join(COLUMNS)}",
    )


def filter_dataset(dataset: Dataset, where: str, out: Path) -> VersionFile:
    """Return the version of a new dataset `out` that holds the episodes for which an expression holds.

    Parts are shared with the dataset, not rewritten: what the expression leaves out of a part that is kept still
    lies in it, excluded by the version. The lineage keeps the expression and that of `dataset`.

    Parameters
    ----------
    dataset : Dataset
        Version to choose from.
    where : str
        Expression, as for `matching`.
    out : Path
        Folder of the new dataset.

    Raises
    ------
    UnknownNameError, UsageError, MissingExtraError
        As for `matching`, and when `out` stands.
    DataError
        When no episode is left, or a part is damaged.
    """
    kept = frozenset(matching(dataset, where))
    if not kept:
        raise DataError(
            "no episode is left", expected="at least 1", found=f"0 of {len(dataset)}",
            where=Where(path=f"filter {where}"), fix="see what there is: candata inspect",
        )  # fmt: skip
    details = {"where": where, "episodes": len(kept), "of": len(dataset)}
    with new_dataset(out) as root:
        entries, excluded = [], set()
        for part in dataset.raw_parts():
            held = {name for name, _ in part.manifest().episodes}
            if held & kept:
                entries.append(link_part(part, root))
                excluded |= held - kept
        link_clouds(dataset, root)
        return publish_first(root, entries, excluded, derived("filter", [dataset], details))
