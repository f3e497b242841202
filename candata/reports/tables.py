"""The tables of the page, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import get_args

from candata.reports import words
from candata.reports.numbers import digits, percent, reading, unit_of
from candata.schema.report import Report, Verdict

NBSP = "\N{NO-BREAK SPACE}"
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
                (
                    words.plain(effect.name),
                    effect.element or "all",
                    name,
                    read.value,
                    read.interval or "not given",
                    read.unit or "1",
                    percent(effect.share),
                    digits(effect.support),
                    "yes" if effect.at_bound else "no",
                )
            )
    head = (
        "effect",
        "element",
        "parameter",
        "value",
        "90 % interval",
        "unit",
        "share of closed gap",
        "support",
        "at bound",
    )
    return table(head, rows, numeric=(3, 4, 6, 7), whole=(0, 5))


def unknown(report: Report) -> str:
    """Return what no effect explains: where it acts, its size, what it depends on; empty for nothing."""
    rest = report.unknown
    if rest is None:
        return ""
    size = f"{digits(rest.size)} {rest.unit or ''}".strip() if rest.size is not None else ""
    acts = " ".join(filter(None, (rest.acts_on, rest.element)))
    rows = [
        ("in words", rest.words),
        ("acts on", acts),
        ("size", size),
        ("depends on", ", ".join(rest.depends_on)),
    ]
    return f"<h2>What stays unexplained</h2>{pairs(rows)}"


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
    used, count = report.data, report.data.episodes
    floor = {
        "measured": "measured from repeated episodes",
        "declared": "declared in the scene",
        "assumed": "assumed from quiet stretches",
    }
    rows = [
        ("dataset", used.dataset),
        (
            "episodes",
            f"{count.total}, of which {count.held_out} held out in {count.folds} folds",
        ),
        ("floor", floor.get(used.floor or "", "none")),
        ("channels", ", ".join(used.channels)),
        *(("note", note) for note in used.notes),
        *report.provenance.items(),
    ]
    return pairs([(words.plain(name), text) for name, text in rows])


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Iterable[int] = (), whole: Iterable[int] = ()
) -> str:
    """Return an HTML table that scrolls sideways where it must.

    Columns in `numeric` stand right, cells of columns in `whole` are not broken.
    """
    right, tied = set(numeric), set(whole)

    def cell(tag: str, column: int, text: str) -> str:
        shown = text.replace(" ", NBSP) if column in tied else text
        return f"<{tag}{NUMERIC if column in right else ''}>{escape(shown)}</{tag}>"

    def line(tag: str, row: Sequence[str]) -> str:
        return f"<tr>{''.join(cell(tag, i, text) for i, text in enumerate(row))}</tr>"

    body = "".join(line("td", row) for row in rows)
    inner = f"<thead>{line('th', head)}</thead><tbody>{body}</tbody>"
    return f'<div class="scroll" tabindex="0"><table>{inner}</table></div>'


def pairs(rows: Iterable[tuple[str, str]]) -> str:
    """Return names beside their texts; rows without a text are left out."""
    body = "".join(f'<tr><th scope="row">{escape(k)}</th><td>{escape(v)}</td></tr>' for k, v in rows if v)
    return f'<table class="wrap"><tbody>{body}</tbody></table>'
