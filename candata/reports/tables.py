"""The tables of the page, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import get_args

from candata.reports import words
from candata.reports.numbers import digits, percent, reading, unit_of
from candata.schema.report import Report, Verdict

#: Attributes of the row of the verdict reached, and of a cell that holds a number.
NOW, NUMERIC = ' class="now"', ' class="n"'


def effects(report: Report) -> str:
    """Return the named effects: parameter, value, 90 % interval, unit, share, support, bound."""
    if not report.effects:
        return f'<p class="card">No effect is named. {escape(words.which(report))}</p>'
    rows = []
    for effect in report.effects:
        for name, estimate in effect.parameters.items():
            read = reading(estimate, unit_of(effect.name, name))
            rows.append(
                (words.plain(effect.name), effect.element or "all", name, read.value, read.interval or "not given",
                 read.unit or "1", percent(effect.share), digits(effect.support), "yes" if effect.at_bound else "no")
            )
    head = ("effect", "element", "parameter", "value", "90 % interval", "unit", "share of closed gap", "support", "at bound")
    return table(head, rows, numeric=(3, 4, 6, 7))


def measures(report: Report) -> str:
    """Return the plain measures, one a row; empty when the record has none."""
    if not report.measures:
        return ""
    columns = list(dict.fromkeys(key for row in report.measures.values() for key in row))
    rows = [
        (words.plain(name), *(digits(row[c]) if c in row else "" for c in columns))
        for name, row in report.measures.items()
    ]
    numeric = range(1, len(columns) + 1)
    return "<h2>In plain measures</h2>" + table(("", *map(words.plain, columns)), rows, numeric=numeric)


def symptoms(report: Report) -> str:
    """Return where the gap shows, strongest first."""
    rows = [(words.capital(words.place(s)), f"{digits(s.ratio)}", words.chance(s.p)) for s in report.where]
    return table(("where", "times the floor", "chance"), rows, numeric=(1, 2)) if rows else ""


def verdicts(report: Report) -> str:
    """Return what the verdict words mean, with the one reached marked."""
    body = "".join(
        f"<tr{NOW if word == report.verdict else ''}><td>{word}</td><td>{escape(words.explain(word))}</td></tr>"
        for word in get_args(Verdict)
    )
    return f'<div class="scroll" tabindex="0"><table><tbody>{body}</tbody></table></div>'


def data(report: Report) -> str:
    """Return what the diagnosis saw and where it came from."""
    used = report.data
    floor = {"measured": "measured from repeated episodes", "declared": "declared in the scene",
             "assumed": "assumed from quiet stretches"}
    rows = [
        ("dataset", used.dataset),
        ("episodes", f"{used.episodes.total}, of which {used.episodes.held_out} held out in {used.episodes.folds} folds"),
        ("floor", floor.get(used.floor or "", "none")),
        ("channels", ", ".join(used.channels)),
        *(("note", note) for note in used.notes),
        *report.provenance.items(),
    ]
    body = "".join(
        f"<tr><th scope='row'>{escape(words.plain(k))}</th><td>{escape(v)}</td></tr>" for k, v in rows if v
    )
    return f'<table class="wrap"><tbody>{body}</tbody></table>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Iterable[int] = ()) -> str:
    """Return an HTML table that scrolls sideways where it must; `numeric` columns stand right."""
    right = set(numeric)

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{NUMERIC if i in right else ''}>{escape(text)}</{tag}>" for i, text in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    head_row = f"<tr>{cells('th', head)}</tr>"
    return f'<div class="scroll" tabindex="0"><table><thead>{head_row}</thead><tbody>{body}</tbody></table></div>'
