"""Matrices as tables of coloured cells: where the gap shows, which candidates are alike, what was taken for what."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from candata.gap.measure.symptoms import HeatMap
from candata.gap.verdict.figures import Collinearity
from candata.reports import words
from candata.reports.document import render
from candata.reports.numbers import digits

#: Family-wise p at or below which a cell of the heat map shows its number.
SIGNIFICANT_P = 0.05
#: Number of colours; ratios below `LEAST_TOP` do not reach the last.
LEVELS, LEAST_TOP = 9, 5.0
#: Ratios that the key of the heat map may name.
KEY_RATIOS = (1, 2, 5, 10, 20, 50, 100, 1000, 10000)
#: Cosine from which on two candidates count as hard to tell apart (reference study: backlash and delay, .65).
ALIKE_COSINE = 0.65


@dataclass(frozen=True)
class HeatCell:
    """A cell: its class, its number, and the text that shows when it is pointed at."""

    css_class: str
    text: str = ""
    tooltip: str = ""
    is_bold: bool = False


@dataclass(frozen=True)
class HeatRow:
    """A row of cells; `group` is the channel's name when its first element begins here."""

    label: str
    name: str
    cells: tuple[HeatCell, ...]
    group: str = ""
    is_clickable: bool = False


def heat_map(heat: HeatMap, clickable: frozenset[str]) -> Markup:
    """Return channel element by phase: mismatch over its floor, log colour, hatched where chance is not ruled out.

    Rows whose label is in `clickable` bear a button that shows the element's episodes.
    """
    ratio, p = np.asarray(heat.ratio, float), np.asarray(heat.p, float)
    top = max(float(np.nanmax(ratio, initial=1.0)) if np.isfinite(ratio).any() else 1.0, LEAST_TOP)
    rows, previous_channel = [], ""
    for k, label in enumerate(heat.rows):
        channel, _, element = label.partition(" ")
        readable_channel = words.readable_name(channel)
        cells = tuple(_ratio_cell(ratio[k, j], p[k, j], top, phase) for j, phase in enumerate(heat.phases))
        group = readable_channel if channel != previous_channel and element else ""
        rows.append(HeatRow(label, element or readable_channel, cells, group, label in clickable))
        previous_channel = channel
    return render("heat_map", phases=heat.phases, rows=rows, key=_key(top))


def collinearity(matrix: Collinearity) -> Markup:
    """Return the cosines between what the candidates change, the numbers of the columns being the rows'."""
    count = len(matrix.labels)
    rows = [
        HeatRow(label, words.label_title(label), tuple(_cosine_cell(matrix, k, j) for j in range(count)))
        for k, label in enumerate(matrix.labels)
    ]
    return render("collinearity", rows=rows)


def confusion(counts: dict[str, dict[str, int]]) -> Markup:
    """Return what was said first for each hidden cause: counts, coloured by their share of the cause's cases."""
    causes = list(counts)
    answers = {answer for row in counts.values() for answer in row}
    columns = [cause for cause in causes if cause in answers] + sorted(answers - set(causes))
    rows = []
    for cause, row in counts.items():
        total = max(sum(row.values()), 1)
        cells = tuple(_count_cell(cause, answer, row.get(answer, 0), total) for answer in columns)
        rows.append(HeatRow(cause, cause, cells))
    return render("confusion", columns=columns, rows=rows)


def level(ratio: float, top: float) -> int:
    """Return the colour of a ratio: 0 at the floor or below it, the last one at `top`, evenly by its logarithm."""
    share = math.log(max(ratio, 1.0)) / math.log(top)
    return min(round((LEVELS - 1) * share), LEVELS - 1)


def _ratio_cell(ratio: float, p: float, top: float, phase: str) -> HeatCell:
    """Return one cell of the heat map: its number where it is significant, all of it when pointed at."""
    if not np.isfinite(ratio):
        return HeatCell("hole", tooltip=f"{phase}: no data")
    p_words = words.p_text(float(p)) if np.isfinite(p) else "not tested"
    is_significant = bool(np.isfinite(p) and p <= SIGNIFICANT_P)
    colour = f"h{level(float(ratio), top)}"
    return HeatCell(
        colour if is_significant else f"{colour} chance",
        digits(float(f"{ratio:.2g}")) if is_significant else "",
        f"{phase}: {words.times_floor(float(ratio))}, {p_words}",
    )


def _key(top: float) -> list[tuple[int, int]]:
    """Return the ratios that the key names, each with its colour."""
    ratios = [ratio for ratio in KEY_RATIOS if ratio <= top]
    ratios += [math.floor(top)] if top > 1.3 * ratios[-1] else []
    return [(ratio, level(ratio, top)) for ratio in ratios]


def _cosine_cell(matrix: Collinearity, row: int, column: int) -> HeatCell:
    """Return one cosine below the diagonal; pairs that are hard to tell apart stand out."""
    if column >= row:
        return HeatCell("diagonal" if column == row else "")
    cosine = float(matrix.matrix[row, column])
    text = f"{cosine:.2f}".replace("0.", ".", 1).replace("-", "\N{MINUS SIGN}")
    colour = min(round((LEVELS - 1) * abs(cosine)), LEVELS - 1)
    return HeatCell(f"h{colour}", text, is_bold=abs(cosine) >= ALIKE_COSINE)


def _count_cell(cause: str, answer: str, count: int, total: int) -> HeatCell:
    """Return how many cases of a cause got an answer; a colour between 1 and 4 tells their share."""
    if not count:
        return HeatCell("")
    return HeatCell(
        f"s{math.ceil(4 * count / total)}", str(count), f"hidden {cause}, said {answer}: {count} of {total}"
    )
