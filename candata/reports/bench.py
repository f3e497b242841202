"""A blind run for people: the table and the misses as text, and a page with confusion matrix and calibration curve."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from candata.datasets.writing import write_text
from candata.gap.blind.honesty import MEANINGS
from candata.reports.chart import Axis, chart, dots, line
from candata.reports.document import render_page
from candata.reports.heat import confusion
from candata.schema.bench import BenchFile, BenchRow, Bin

#: Last column of the table by whether a target is met; None when there is no target.
MARKS = {True: "met", False: "MISSED", None: ""}
HEAD = ("measure", "measured", "n", "target", "")
MISS_HEAD = ("missed", "kind", "truth", "verdict", "named", "gap before", "why")


def bench_text(bench: BenchFile) -> str:
    """Return the table, rows below target first, then the missed cases, then the baselines side by side."""
    parts = [
        f"{bench.scene}: {bench.done} of {bench.cases} cases, {len(bench.misses)} missed",
        _text_table(HEAD, _measure_rows(bench)),
    ]
    if bench.misses:
        parts.append(_text_table(MISS_HEAD, _miss_rows(bench)))
    if bench.baselines:
        parts.append(_text_table(_baseline_head(bench), _baseline_rows(bench)))
    return "\n\n".join(parts)


def write_bench(bench: BenchFile, out: Path) -> Path:
    """Return the path of `bench.html` after writing it beside `bench.json` into `out`."""
    write_text(out / "bench.json", bench.model_dump_json(indent=1) + "\n")
    return write_text(out / "bench.html", bench_page(bench))


def bench_page(bench: BenchFile) -> str:
    """Return the page as text; it asks for nothing from elsewhere."""
    missed_count = sum(row.is_met is False for row in bench.rows)
    target_count = sum(row.is_met is not None for row in bench.rows)
    return render_page(
        "bench",
        title=f"Blind check: {bench.scene}",
        tone="bad" if missed_count else "good",
        bench=bench,
        headline=f"{target_count - missed_count} of {target_count} targets met",
        head=HEAD,
        rows=_measure_rows(bench),
        meanings=_meaning_rows(bench),
        confusion=confusion(bench.confusion) if bench.confusion else "",
        calibration=calibration(bench.calibration) if bench.calibration else "",
        miss_head=MISS_HEAD,
        misses=_miss_rows(bench),
        baseline_head=_baseline_head(bench) if bench.baselines else (),
        baseline_rows=_baseline_rows(bench),
    )


def calibration(bins: Sequence[Bin]) -> Markup:
    """Return stated support against the share that was right, and the line on which both are equal."""
    ticks = tuple((k / 5, f"{k / 5:g}") for k in range(6))
    x, y = Axis(0.0, 1.03, ticks), Axis(0.0, 1.03, ticks)
    support, share = [point.support for point in bins], [point.right for point in bins]

    def tooltip(k: int) -> str:
        return f"stated {support[k]:.2f}, right {share[k]:.2f} of {bins[k].n}"

    marks = line(x, y, [0.0, 1.0], [0.0, 1.0], "ideal") + line(x, y, support, share, "after")
    marks += dots(x, y, support, share, "after", tooltip)
    return chart(x, y, marks, "stated support against the share that was right", 280, "stated support", "share right")


def _measure_rows(bench: BenchFile) -> list[tuple[str, ...]]:
    """Return the rows of the table."""
    return [(row.measure, value_text(row), str(row.n), target_text(row), mark_text(row)) for row in bench.rows]


def _meaning_rows(bench: BenchFile) -> list[tuple[str, str]]:
    """Return what rows that need a word say."""
    measures = [row.measure for row in bench.rows]
    return [(part, meaning) for part, meaning in MEANINGS.items() if any(part in measure for measure in measures)]


def _miss_rows(bench: BenchFile) -> list[tuple[str, ...]]:
    """Return the rows of the missed cases."""
    return [
        (m.case, m.kind, m.truth, m.verdict, m.named, "-" if m.gap is None else f"{m.gap:.3g}", m.why)
        for m in bench.misses
    ]


def _baseline_head(bench: BenchFile) -> tuple[str, ...]:
    """Return the columns of the methods side by side."""
    methods = bench.baselines
    return (f"measure ({methods[0].done} cases)", *(method.method for method in methods))


def _baseline_rows(bench: BenchFile) -> list[tuple[str, ...]]:
    """Return each measure of the methods side by side."""
    tables = [{row.measure: row for row in method.rows} for method in bench.baselines]
    measures = list(dict.fromkeys(row.measure for method in bench.baselines for row in method.rows))
    return [(name, *(value_text(t[name]) if name in t else "-" for t in tables)) for name in measures]


def value_text(row: BenchRow) -> str:
    """Return a measured value with its unit."""
    if row.value is None:
        return "-"
    return f"{row.value:.1f} {row.unit}" if row.unit else f"{row.value:.3f}"


def mark_text(row: BenchRow) -> str:
    """Return whether a row meets its target, and the interval of its value where it has one."""
    if row.interval is None:
        return MARKS[row.is_met]
    digits = 1 if row.unit else 3
    return f"{MARKS[row.is_met]} ({row.interval[0]:.{digits}f} to {row.interval[1]:.{digits}f})".strip()


def target_text(row: BenchRow) -> str:
    """Return the target of a row in words; empty for none."""
    low, high = ("" if v is None else f"{v:g}" for v in (row.low, row.high))
    unit = f" {row.unit}" if row.unit else ""
    if low and high:
        return f"{low} to {high}{unit}"
    return f">= {low}{unit}" if low else (f"<= {high}{unit}" if high else "")


def _text_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as text with aligned columns, the header first."""
    cells = [list(head), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in cells]
    return "\n".join(line.rstrip() for line in lines)
