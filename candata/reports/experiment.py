"""The page of an experiment: its table, the four answers by real episodes, repairs and failures; and its summary."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from candata.datasets.writing import write_text
from candata.experiment.results import Answer, ColumnFacts, ExperimentTable, Row, Value
from candata.reports.document import render_page
from candata.reports.numbers import digits, percent

DASH = "\N{EN DASH}"
HEAD = (
    "",
    "real episodes",
    "runs",
    "MSE",
    "ADD-S AUC",
    "within 5 cm",
    "gap closed",
    "error, floors",
    "paper: AUC",
    "within 5 cm",
    "MSE",
)
#: The four answers in words, in the order of the small table.
ANSWERS: dict[Answer, str] = {
    "nothing": "nothing: the nominal simulator",
    "repair": "repair: the simulator with what the diagnosis found",
    "model": "model: pre-trained on the nominal simulation, then on real episodes",
    "both": "both: on or over the repaired simulation, then on real episodes",
}


def write_experiment(table: ExperimentTable, out: Path) -> Path:
    """Return the path of `table.html` after writing it into `out`, whole or not.

    Raises
    ------
    SetupError
        When the folder cannot be written.
    """
    return write_text(out / "table.html", page(table))


def page(table: ExperimentTable) -> str:
    """Return the whole page as text."""
    scale = "" if table.scale == 1 else f", at {percent(table.scale)} of its episodes and steps"
    return render_page(
        "experiment",
        title=f"{table.headline}: {table.title}",
        tone="bad" if table.failed else "good",
        headline=table.headline,
        kicker=f"{table.title}{scale}",
        findings=table.findings,
        notes=table.notes,
        head=HEAD,
        columns=[
            (title, _column_words(facts), [_cells(row) for row in table.rows if row.column == title])
            for title, facts in table.columns.items()
        ],
        answer_tables=[
            (title, counts, _answer_rows(table, title, counts))
            for title in table.columns
            if len(counts := _counts(table, title)) > 1
        ],
        repairs=[
            (
                repair.name,
                repair.verdict.replace("_", " "),
                ", ".join(repair.effects) or DASH,
                DASH if repair.closed is None else percent(repair.closed),
            )
            for repair in table.repairs
        ],
        failed=list(table.failed.items()),
        method=_method(table),
    )


def summary(table: ExperimentTable) -> str:
    """Return what the command line prints: the first line, and a row for each of the table."""
    lines = [table.headline, *table.findings, ""]
    for title, facts in table.columns.items():
        lines.append(f"{title}: {facts.test_episodes} test episodes, {facts.real}")
        rows = [("", "real", "ADD-S AUC", "within 5 cm", "gap closed")]
        for row in table.rows:
            if row.column == title:
                cells = _cells(row)
                rows.append((cells[0], cells[1], cells[4], cells[5], cells[6]))
        widths = [max(len(row[i]) for row in rows) for i in range(5)]
        lines += ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        lines.append("")
    return "\n".join([*lines, *table.notes]).rstrip()


def _column_words(facts: ColumnFacts) -> str:
    """Return what a column was tested on, and what its floor is."""
    words = f"{facts.test_episodes} test episodes of {facts.real}. "
    if facts.floor_auc is not None:
        words += f"The floor is {facts.floor}: ADD-S AUC {100 * facts.floor_auc:.1f} %. "
    if facts.opened:
        words += f"The seal, opened once the table was written, held {'; '.join(facts.opened)}."
    return words


def _cells(row: Row) -> tuple[str, ...]:
    """Return the cells of one row of the table."""
    paper = row.paper
    label = row.label if row.failed is None else f"{row.label}: failed, {row.failed.splitlines()[0]}"
    return (
        label,
        "all" if row.real_count is None else str(row.real_count),
        str(row.seeds),
        _number(row.mse),
        _share(row.adds_auc),
        _share(row.success),
        _share(row.closed, decimals=0),
        DASH if row.excess is None else digits(row.excess),
        DASH if paper is None or paper.adds_auc is None else f"{100 * paper.adds_auc:.1f} %",
        DASH if paper is None or paper.success is None else f"{100 * paper.success:.1f} %",
        DASH if paper is None or paper.mse is None else f"{paper.mse:.4f}",
    )


def _counts(table: ExperimentTable, title: str) -> list[int]:
    """Return the numbers of real episodes of a column, in rising order."""
    return sorted({row.real_count for row in table.rows if row.column == title and row.real_count is not None})


def _answer_rows(table: ExperimentTable, title: str, counts: Sequence[int]) -> list[tuple[str, ...]]:
    """Return the four answers of a column: AUC and share of the gap at each number of real episodes."""
    rows = [row for row in table.rows if row.column == title]
    return [(words, *(_answer_cell(rows, answer, count) for count in counts)) for answer, words in ANSWERS.items()]


def _answer_cell(rows: Sequence[Row], answer: Answer, count: int) -> str:
    """Return AUC and share of the gap of an answer; without real episodes a repair is nothing, and both the model."""
    if answer == "nothing" or (answer == "repair" and count == 0):
        chosen = [row for row in rows if row.answer == "nothing"]
    else:
        meant = "model" if count == 0 else answer
        chosen = [row for row in rows if row.answer == meant and row.real_count == count]
    chosen = sorted(
        (row for row in chosen if row.adds_auc.value is not None),
        key=lambda row: row.regime_rank,
    )
    if not chosen:
        return DASH
    return f"{_share(chosen[0].adds_auc)}; closes {_share(chosen[0].closed, decimals=0)}"


def _method(table: ExperimentTable) -> list[tuple[str, str]]:
    """Return what a reader must know to judge the numbers."""
    return [
        (
            "ADD-S AUC",
            "closed loop over whole episodes, area under the accuracy curve up to 0.1 m, mean over episodes and seeds",
        ),
        ("within 5 cm", "share of episodes whose last position lies within 5 cm of the recorded one"),
        (
            "MSE",
            "one forecast of the whole horizon: mean square of the six numbers of a pose increment, m and rad mixed; "
            "the paper gives no unit",
        ),
        ("intervals", "95 %, over resampled episodes and seeds, the same draws for all rows"),
        (
            "gap closed",
            "(AUC less that of the nominal simulator) / (AUC of the floor less the same); below zero it has grown",
        ),
        (
            "error, floors",
            "closed-loop error over that of the floor, the mean over position and rotation, as a diagnosis measures: "
            "1 is the floor",
        ),
        ("paper", "arXiv 2601.12796: other data, so to be compared in order rather than in size"),
        ("candata", table.revision),
    ]


def _share(value: Value, decimals: int = 1) -> str:
    """Return a share in per cent with its interval."""
    if value.value is None:
        return DASH
    text = f"{100 * value.value:.{decimals}f} %"
    if value.low is None or value.high is None:
        return text
    return f"{text} ({100 * value.low:.{decimals}f} to {100 * value.high:.{decimals}f})"


def _number(value: Value) -> str:
    """Return a number with its interval."""
    if value.value is None:
        return DASH
    if value.low is None or value.high is None:
        return f"{value.value:.2g}"
    return f"{value.value:.2g} ({value.low:.2g} to {value.high:.2g})"
