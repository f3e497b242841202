"""Two matrices as tables of coloured cells: where the gap shows, and which candidates are alike."""

from __future__ import annotations

import math
from html import escape

import numpy as np

from candata.gap.evidence import Collinearity, HeatMap
from candata.reports import words
from candata.reports.numbers import digits

#: Family-wise p at or below which a cell of the heat map shows its number.
SIGNIFICANT_P = 0.05
#: Number of colours; ratios below `LEAST_TOP` do not reach the last.
LEVELS, LEAST_TOP = 9, 5.0
#: Ratios that the key of the heat map may name.
KEY_RATIOS = (1, 2, 5, 10, 20, 50, 100, 1000, 10000)
#: Cosine from which on two candidates count as hard to tell apart (reference study: backlash and delay, .65).
ALIKE = 0.65


def heat_map(heat: HeatMap, clickable: frozenset[str]) -> str:
    """Return channel element by phase: mismatch over its floor, log colour, hatched where there is no data.

    Rows whose label is in `clickable` bear a button that shows the element's episodes.
    """
    ratio, p = np.asarray(heat.ratio, float), np.asarray(heat.p, float)
    top = max(float(np.nanmax(ratio, initial=1.0)) if np.isfinite(ratio).any() else 1.0, LEAST_TOP)
    head = "".join(f'<th scope="col">{escape(words.plain(phase))}</th>' for phase in heat.phases)
    rows, last = [], ""
    for k, label in enumerate(heat.rows):
        channel, _, element = label.partition(" ")
        if channel != last and element:
            rows.append(
                f'<tr class="group"><th scope="rowgroup" colspan="{len(heat.phases) + 1}">'
                f"{escape(words.plain(channel))}</th></tr>"
            )
        last = channel
        cells = "".join(_cell(ratio[k, j], p[k, j], top, phase) for j, phase in enumerate(heat.phases))
        rows.append(_row(label, cells, label in clickable))
    return (
        f'<div class="scroll" tabindex="0"><table class="heat"><thead><tr><td></td>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>{_key(top)}"
    )


def collinearity(found: Collinearity) -> str:
    """Return the cosines between what the candidates change, the numbers of the columns being the rows'."""
    count = len(found.labels)
    head = "".join(f'<th scope="col">{k + 1}</th>' for k in range(count))
    rows = []
    for k, label in enumerate(found.labels):
        cells = "".join(_cosine(float(found.matrix[k, j])) if j < k else _own(j == k) for j in range(count))
        rows.append(f'<tr><th scope="row"><b>{k + 1}</b> {escape(words.plain(label))}</th>{cells}</tr>')
    return (
        f'<div class="scroll" tabindex="0"><table class="heat alike"><thead><tr><td></td>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def level(ratio: float, top: float) -> int:
    """Return the colour of a ratio: 0 at the floor or below it, the last one at `top`, evenly by its logarithm."""
    share = math.log(max(ratio, 1.0)) / math.log(top)
    return min(round((LEVELS - 1) * share), LEVELS - 1)


def _row(label: str, cells: str, clickable: bool) -> str:
    """Return one row; its name is a button where the element's episodes are on the page."""
    name = escape(label.partition(" ")[2] or words.plain(label))
    if not clickable:
        return f'<tr><th scope="row">{name}</th>{cells}</tr>'
    return (
        f'<tr class="pick" data-shows="{escape(label)}"><th scope="row">'
        f'<button type="button" aria-pressed="false">{name}</button></th>{cells}</tr>'
    )


def _cell(ratio: float, p: float, top: float, phase: str) -> str:
    """Return one cell: its number where it is significant, all of it when pointed at."""
    if not np.isfinite(ratio):
        return f'<td class="hole" title="{escape(phase)}: no data"></td>'
    tested = words.chance(float(p)) if np.isfinite(p) else "not tested"
    shown = digits(float(f"{ratio:.2g}")) if np.isfinite(p) and p <= SIGNIFICANT_P else ""
    tip = f"{phase}: {words.times(float(ratio))}, {tested}"
    return f'<td class="h{level(float(ratio), top)}" title="{escape(tip)}">{shown}</td>'


def _key(top: float) -> str:
    """Return the key of the colours."""
    marks = [r for r in KEY_RATIOS if r <= top]
    marks += [math.floor(top)] if top > 1.3 * marks[-1] else []
    cells = "".join(f'<span class="h{level(r, top)}">{r:,}×</span>' for r in marks)
    return f'<p class="scale"><i class="hole"></i>no data {cells}</p>'


def _cosine(value: float) -> str:
    """Return one cosine; pairs that are hard to tell apart stand out."""
    colour = min(round((LEVELS - 1) * abs(value)), LEVELS - 1)
    text = f"{value:.2f}".replace("0.", ".", 1).replace("-", "\N{MINUS SIGN}")
    return f'<td class="h{colour}">' + (f"<b>{text}</b>" if abs(value) >= ALIKE else text) + "</td>"


def _own(same: bool) -> str:
    """Return a cell of the diagonal or above it."""
    return '<td class="own"></td>' if same else "<td></td>"
