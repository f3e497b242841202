"""The tables of the page, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import get_args

from candata.gap.evidence import Range
from candata.reports import advice, figures, words
from candata.reports.numbers import digits, percent, reading, unit_of
from candata.schema.record import Record
from candata.schema.report import Estimate, Report, Verdict

NBSP = "\N{NO-BREAK SPACE}"
#: Attributes of the row of the verdict reached, and of a cell that holds a number.
NOW, NUMERIC = ' class="now"', ' class="n"'


def effects(report: Report, ranges: Mapping[tuple[str, str | None, str], Range]) -> str:
    """Return the named effects: value, 90 % interval, the range searched with bounds marked, share and support."""
    if not report.effects:
        return ""
    body = []
    for effect in report.effects:
        for name, estimate in effect.parameters.items():
            unit = unit_of(effect.name, name, estimate)
            read, where = reading(estimate, unit), ranges.get((effect.name, effect.element, name))
            bound = ' <span class="tag">at bound</span>' if effect.at_bound else ""
            cells = (
                (words.title(effect.name, effect.element), "u"),
                (f"{name} [{read.unit}]" if read.unit else name, "u"),
                (read.value, "n"),
                (read.interval or "not given", "n"),
                (percent(effect.share), "n"),
                (digits(effect.support), "n"),
            )
            plain = [f'<td class="{kind}">{escape(text)}</td>' for text, kind in cells]
            searched = f"<td>{_searched(where, unit)}{bound}{figures.parameter(estimate, where)}</td>"
            body.append(f"<tr>{''.join((*plain[:4], searched, *plain[4:]))}</tr>")
    head = ("effect", "parameter", "value", "90 % interval", "range searched", "share of closed gap", "support")
    top = "".join(f"<th{NUMERIC if i in (2, 3, 5, 6) else ''}>{escape(text)}</th>" for i, text in enumerate(head))
    note = (
        '<p class="note">A mark inside a range, where there is one, is the value without the effect.</p>'
        if ranges
        else ""
    )
    return (
        "<h2>Named effects</h2>"
        f'<div class="scroll" tabindex="0"><table><thead><tr>{top}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>{note}"
    )


def _searched(where: Range | None, unit: str) -> str:
    """Return `0 to 0.3 N m`; empty without a range."""
    if where is None:
        return ""
    ends = Estimate(value=(where.low, where.high), low=(where.low, where.high), high=(where.low, where.high))
    read = reading(ends, unit)
    return escape(f"{' to '.join(read.value.strip('[]').split(', '))} {read.unit}".strip())


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
        *([("closable by a fitted force", percent(rest.closable))] if rest.closable is not None else []),
        *_further(rest, {"words", "acts_on", "element", "size", "unit", "depends_on", "closable"}),
    ]
    return f"<h2>What stays unexplained</h2>{pairs(rows)}"


def next_motion(report: Report) -> str:
    """Return what to record next: the motion, its file, what it separates; empty when nothing is proposed."""
    motion = report.next_motion
    if motion is None:
        return ""
    rows = [
        ("motion", words.plain(motion.name)),
        ("command file", motion.file or ""),
        ("separates", words.listed([words.plain(name) for name in motion.separates], "from")),
        ("how", "play it on the real hand, append the recording to the dataset, and diagnose again"),
        *_further(motion, {"name", "file", "separates"}),
    ]
    return f"<h2>What to record next</h2>{pairs(rows)}"


def further(report: Report) -> str:
    """Return what newer versions of the record hold beyond what this page knows; empty for nothing."""
    known = {"verdict", "effects", "ambiguous_class", "unknown", "ranking", "gap", "where", "next_motion", "data"}
    rows = _further(report, known | {"measures", "provenance"})
    return f"<h2>Further</h2>{pairs(rows)}" if rows else ""


def untested(report: Report) -> str:
    """Return what could not be tested and why: channels, effects that nothing shows, effects that cannot act."""
    rows = [(words.plain(c), "not recorded, so it was not compared") for c in advice.missing_channels(report)]
    rows += [(words.capital(what), why) for what, why in advice.untested(report)]
    if not rows:
        return ""
    body = "".join(f"<tr><td>{escape(what)}</td><td>{escape(why)}</td></tr>" for what, why in rows)
    return (
        '<h2>What could not be tested, and what was best left out</h2><table class="wrap">'
        "<thead><tr><th>what</th><th>why</th></tr></thead>"
        f"<tbody>{body}</tbody></table>"
    )


def _further(record: Record, known: set[str]) -> list[tuple[str, str]]:
    """Return the fields of a record that are not known here, nested ones with their own names."""
    rows = []
    for name in type(record).model_fields:
        value = getattr(record, name)
        if name in known or value in (None, (), "", {}):
            continue
        inner = value.model_dump(mode="json") if isinstance(value, Record) else value
        text = ", ".join(f"{words.plain(k)} {v}" for k, v in inner.items()) if isinstance(inner, dict) else str(inner)
        rows.append((words.plain(name), text))
    return rows


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


def verdicts(report: Report) -> str:
    """Return what the verdict words mean, with the one reached marked."""
    body = "".join(
        f"<tr{NOW if word == report.verdict else ''}><td>{word}</td><td>{escape(words.explain(word))}</td></tr>"
        for word in get_args(Verdict)
    )
    body += "".join(f"<tr><td>{term}</td><td>{escape(text)}</td></tr>" for term, text in words.TERMS.items())
    return f'<table class="wrap terms"><tbody>{body}</tbody></table>'


def data(report: Report) -> str:
    """Return what the diagnosis saw and where it came from."""
    used, count = report.data, report.data.episodes
    held_out = "each held out once" if count.held_out == count.total else f"of which {count.held_out} held out"
    floor = {
        "measured": "measured from repeated episodes",
        "declared": "declared in the scene",
        "assumed": "assumed from quiet stretches",
    }
    rows = [
        ("dataset", used.dataset),
        (
            "episodes",
            f"{count.total}, {held_out} in {count.folds} folds",
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
