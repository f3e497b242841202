"""A blind run for people: the table and the misses as text, and a page with confusion matrix and calibration curve."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from candata.reports.document import document, figure, plot, plotly
from candata.reports.writing import write_text
from candata.schema.bench import BenchFile, BenchRow, Bin

Spec = dict[str, Any]
#: What the last column of the table says.
MARKS = {True: "met", False: "MISSED", None: ""}
HEAD = ("measure", "measured", "n", "target", "")
MISS_HEAD = ("missed", "kind", "truth", "verdict", "named", "gap before", "why")


def bench_text(found: BenchFile) -> str:
    """Return the table, rows below target first, then the cases that were missed, then the baselines beside."""
    parts = [
        f"{found.scene}: {found.done} of {found.cases} cases, {len(found.misses)} missed",
        _aligned(HEAD, _cells(found)),
    ]
    if found.misses:
        parts.append(_aligned(MISS_HEAD, _misses(found)))
    if found.baselines:
        parts.append(_aligned(*_beside(found)))
    return "\n\n".join(parts)


def write_bench(found: BenchFile, out: Path) -> Path:
    """Return the path of `bench.html` after writing it beside `bench.json` into `out`."""
    write_text(out / "bench.json", found.model_dump_json(indent=1) + "\n")
    return write_text(out / "bench.html", bench_page(found))


def bench_page(found: BenchFile) -> str:
    """Return the page as text; it asks for nothing from elsewhere."""
    missed = [row for row in found.rows if row.is_met is False]
    specs: dict[str, Spec] = {}
    parts = [
        f'<header><p class="kicker">Blind check in {escape(found.scene)}: {found.done} of {found.cases} cases</p>'
        f"<h1>{_headline(found, missed)}</h1>"
        '<p class="meaning">Causes were drawn from a secret number, sealed, diagnosed from the data alone, then '
        f"opened. {len(found.misses)} cases count as missed.</p></header>",
        _table(HEAD, _cells(found)),
        _figures(found, specs),
        "<h2>Missed cases</h2>" + (_table(MISS_HEAD, _misses(found)) if found.misses else "<p>None.</p>"),
    ]
    if found.baselines:
        parts.append("<h2>Baselines, on the same cases</h2>" + _table(*_beside(found)))
    return document(f"Blind check: {found.scene}", "bad" if missed else "good", "".join(parts), plotly(specs))


def _headline(found: BenchFile, missed: Sequence[BenchRow]) -> str:
    """Return how many targets were met."""
    judged = sum(row.is_met is not None for row in found.rows)
    return f"{judged - len(missed)} of {judged} targets met"


def _figures(found: BenchFile, specs: dict[str, Spec]) -> str:
    """Return the confusion matrix and the calibration curve; adds their specifications."""
    parts = []
    if found.confusion:
        specs["confusion"] = confusion_map(found.confusion)
        sub = "rows: what was hidden, alone; columns: what was named first, or the verdict where nothing was"
        parts.append(f'<div class="strip">{figure("What was taken for what", sub, plot("confusion", specs))}</div>')
    if found.calibration:
        specs["calibration"] = calibration_curve(found.calibration)
        sub = "stated support of named effects against the share that was right, five bins of equal count"
        parts.append(f'<div class="strip">{figure("Is the support honest?", sub, plot("calibration", specs))}</div>')
    return "".join(parts)


def confusion_map(confusion: dict[str, dict[str, int]]) -> Spec:
    """Return what was said first for each hidden cause, as shares of its cases; counts in the cells."""
    truths = list(confusion)
    said = {word for row in confusion.values() for word in row}
    columns = [t for t in truths if t in said] + sorted(said - set(truths))
    counts = [[confusion[t].get(c, 0) for c in columns] for t in truths]
    shares = [[n / max(sum(row), 1) if n else None for n in row] for row in counts]
    data = {
        "type": "heatmap", "x": columns, "y": truths, "z": shares, "zmin": 0, "zmax": 1, "showscale": False,
        "colorscale": [[0, "@heat0"], [1, "@accent"]], "xgap": 1, "ygap": 1,
        "text": [[str(n) if n else "" for n in row] for row in counts], "texttemplate": "%{text}",
        "hovertemplate": "hidden %{y}<br>said %{x}: %{text}<extra></extra>",
    }  # fmt: skip
    axis = {"fixedrange": True, "automargin": True, "showgrid": False, "dtick": 1, "ticks": ""}
    layout = {
        "height": 170 + 17 * len(truths),
        "margin": {"l": 8, "r": 8, "t": 8, "b": 8},
        "xaxis": {**axis, "side": "top", "tickangle": -60},
        "yaxis": {**axis, "autorange": "reversed"},
    }
    return {"data": [data], "layout": layout}


def calibration_curve(bins: Sequence[Bin]) -> Spec:
    """Return stated support against the share that was right, and the line on which both are equal."""
    ideal = {"type": "scatter", "mode": "lines", "x": [0, 1], "y": [0, 1], "hoverinfo": "skip",
             "line": {"color": "@quiet", "width": 1, "dash": "dot"}}  # fmt: skip
    found = {
        "type": "scatter", "mode": "lines+markers", "x": [b.support for b in bins], "y": [b.right for b in bins],
        "text": [str(b.n) for b in bins], "line": {"color": "@accent", "width": 2}, "marker": {"size": 9},
        "hovertemplate": "stated %{x:.2f}, right %{y:.2f} of %{text}<extra></extra>",
    }  # fmt: skip
    axis = {"range": [0, 1.03], "fixedrange": True}
    layout = {
        "height": 320,
        "margin": {"l": 48, "r": 12, "t": 8, "b": 40},
        "xaxis": {**axis, "title": {"text": "stated support"}},
        "yaxis": {**axis, "title": {"text": "share right"}},
    }
    return {"data": [ideal, found], "layout": layout}


def _cells(found: BenchFile) -> list[tuple[str, ...]]:
    """Return the cells of the table."""
    return [(r.measure, value_text(r), str(r.n), target_text(r), MARKS[r.is_met]) for r in found.rows]


def _misses(found: BenchFile) -> list[tuple[str, ...]]:
    """Return the cells of the missed cases."""
    return [
        (m.case, m.kind, m.truth, m.verdict, m.named, "-" if m.gap is None else f"{m.gap:.3g}", m.why)
        for m in found.misses
    ]


def _beside(found: BenchFile) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and cells of the methods side by side."""
    methods = found.baselines
    tables = [{row.measure: row for row in one.rows} for one in methods]
    measures = list(dict.fromkeys(row.measure for one in methods for row in one.rows))
    rows = [(m, *(value_text(t[m]) if m in t else "-" for t in tables)) for m in measures]
    return (f"measure ({methods[0].done} cases)", *(one.method for one in methods)), rows


def value_text(row: BenchRow) -> str:
    """Return a measured value with its unit."""
    if row.value is None:
        return "-"
    return f"{row.value:.1f} {row.unit}" if row.unit else f"{row.value:.3f}"


def target_text(row: BenchRow) -> str:
    """Return the target of a row in words; empty for none."""
    low, high = ("" if v is None else f"{v:g}" for v in (row.low, row.high))
    unit = f" {row.unit}" if row.unit else ""
    if low and high:
        return f"{low} to {high}{unit}"
    return f">= {low}{unit}" if low else (f"<= {high}{unit}" if high else "")


def _aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return aligned columns, the header first."""
    cells = [list(head), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in cells]
    return "\n".join(line.rstrip() for line in lines)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as HTML."""
    top = "".join(f"<th>{escape(word)}</th>" for word in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
