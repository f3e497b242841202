"""Choosing episodes by an expression over the catalog, and a dataset of the chosen ones without rewriting data."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from candata.datasets import encode
from candata.datasets.dataset import Dataset
from candata.datasets.deriving import Finish, link_clouds, link_part, new_dataset, nothing_more, publish_first
from candata.datasets.history import derived
from candata.errors import DataError, MissingExtraError, UnknownNameError, UsageError, Where
from candata.schema.manifest import VersionFile

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

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
    "memory_limit": "1GB",
    "temp_directory": "",  # what does not fit is refused, not spilled into the folder the user stands in
}
#: Longest that an expression may take [s]: 100,000 episodes take less than 0.1 s.
LIMIT_S = 10.0
#: Time to end for what was interrupted [s].
_GRACE_S = 1.0
#: Longest expression [characters], and how many brackets may be open in it: deep nesting keeps the parser busy
#: for minutes, where nothing can stop it.
LIMIT_LENGTH, LIMIT_OPEN = 10_000, 50
#: Words that tell another thing each time and that the catalog of functions does not list as doing so.
_FLEETING = frozenset(
    ("age", "current_catalog", "current_date", "current_localtime", "current_localtimestamp", "current_role",
     "current_time", "current_timestamp", "current_user", "localtime", "localtimestamp", "sample", "session_user",
     "tablesample", "user", "version")
)  # fmt: skip


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
        When it is no single expression that is true or false of an episode, takes longer than `LIMIT_S`, or tells
        another thing another time, as `random()` and `now()` do.
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
    _require_short(where)
    database = duckdb.connect(":memory:", config=_CLOSED)

    def ask() -> list[tuple[str]]:
        with database:
            return database.from_arrow(catalog).filter(duckdb.SQLExpression(where)).project("id").fetchall()

    try:
        where.encode()  # bytes of the command line that are no text come as lone surrogates
        _require_lasting(database, where)
        return tuple(row[0] for row in _in_time(ask, database.interrupt, where))
    except (duckdb.Error, UnicodeError) as error:
        raise _wrong(where, str(error)) from None


def _require_short(where: str) -> None:
    """Refuse what the parser would need minutes for."""
    if len(where) > LIMIT_LENGTH:
        raise UsageError("the filter is too long", expected=f"at most {LIMIT_LENGTH} characters", found=str(len(where)))
    deepest = max(accumulate((char == "(") - (char == ")") for char in where), default=0)
    if deepest > LIMIT_OPEN:
        raise UsageError(
            "the filter is nested too deep", expected=f"at most {LIMIT_OPEN} open brackets", found=str(deepest)
        )


def _require_lasting(database: DuckDBPyConnection, where: str) -> None:
    """Refuse what tells something else tomorrow: the same filter of the same version gives the same episodes."""
    import duckdb

    data, tokens = where.encode(), duckdb.tokenize(where)
    ends = [*(at for at, _ in tokens[1:]), len(data)]
    names = (duckdb.token_type.identifier, duckdb.token_type.keyword)
    found = [data[at:end].decode() for (at, kind), end in zip(tokens, ends, strict=False) if kind in names]
    words = {text.strip(' \t\n"').lower() for text in found}
    words -= {*COLUMNS}
    fleeting = words & _FLEETING
    if words - fleeting:  # asking costs 15 ms
        asked = "select function_name from duckdb_functions() where stability <> 'CONSISTENT' and function_name in ?"
        fleeting |= {name for (name,) in database.execute(asked, [sorted(words)]).fetchall()}
    if fleeting:
        raise UsageError(
            f"{', '.join(sorted(fleeting))}: the filter would give other episodes another time",
            expected="columns compared with values", where=Where(path=f"filter {where}"),
            fix="a part drawn by chance, the same each time: candata registry split DATASET NAME --seed 3",
        )  # fmt: skip


def _in_time(ask: Callable[[], list[tuple[str]]], interrupt: Callable[[], None], where: str) -> list[tuple[str]]:
    """Return what `ask` returns, or refuse an expression that takes too long: some stop only long after they are told.

    Asked in a thread that does not keep the process alive.
    """
    answer: Future[list[tuple[str]]] = Future()

    def work() -> None:
        try:
            answer.set_result(ask())
        except BaseException as error:  # handed on to whoever waits
            answer.set_exception(error)

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    try:
        return answer.result(LIMIT_S)
    except FutureTimeoutError:
        interrupt()
        worker.join(_GRACE_S)
        raise UsageError(
            "the filter takes too long", expected=f"at most {LIMIT_S:g} s", where=Where(path=f"filter {where[:200]}"),
            fix="compare columns with values; a subselect over a large range has no place here",
        ) from None  # fmt: skip


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


def filter_dataset(dataset: Dataset, where: str, out: Path, finish: Finish = nothing_more) -> VersionFile:
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
    finish : callable
        Takes the new dataset before it appears; `candata.loaders.carry_splits` makes one.

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
    with new_dataset(out, finish) as root:
        entries, excluded = [], set()
        for part in dataset.raw_parts():
            held = {name for name, _ in part.manifest().episodes}
            if held & kept:
                entries.append(link_part(part, root))
                excluded |= held - kept
        link_clouds(dataset, root)
        return publish_first(root, entries, excluded, derived("filter", [dataset], details))
