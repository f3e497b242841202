"""Values as small HTML tables: what a notebook shows of an object."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

#: Rows of a table; a notebook's cell holds about so many without scrolling.
MOST_ROWS = 12


def summary_table(
    heading: str, facts: str, columns: Sequence[str], rows: Iterable[Sequence[object]], total: int | None = None
) -> str:
    """Return a heading, a line of facts and a table as HTML; all text is escaped.

    Parameters
    ----------
    heading : str
        What the object is.
    facts : str
        One line about it.
    columns : sequence of str
        Heads of the columns.
    rows : iterable of sequence
        One value a column; the rows after the first `MOST_ROWS` are counted, not shown.
    total : int, optional
        Number of rows, where `rows` are only the first of them.
    """
    all_rows = list(rows)
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{escape(str(value))}</td>' for value in row) + "</tr>"
        for row in all_rows[:MOST_ROWS]
    )
    hidden_count = (total or len(all_rows)) - MOST_ROWS
    note = f"<small>{hidden_count:,} more rows are not shown.</small>" if hidden_count > 0 else ""
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if all_rows else ""
    return f"<div><b>{escape(heading)}</b><br>{escape(facts)}{table}{note}</div>"
