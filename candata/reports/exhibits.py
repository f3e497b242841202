"""The episodes of each element, hidden until its row of the heat map is clicked."""

from __future__ import annotations

from html import escape

import numpy as np

from candata.gap.evidence import Course, Element, Elements, HeatMap
from candata.reports import words
from candata.reports.chart import Axis, chart, dots, line, linear, listing
from candata.reports.numbers import digits
from candata.schema.report import Report

#: Episodes drawn as dots; of more, some are left out evenly from the worst to the best.
MOST_DOTS = 40
#: SI unit to the unit of a small residual and the factor to it.
SMALL = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "N": ("mN", 1e3)}


def panels(found: Elements, first: str, after: str) -> str:
    """Return a panel for each element, the one whose label is `first` open; `after` names the repaired simulation."""
    cells = "".join(_panel(one, found.ids, after, one.label != first) for one in found.of)
    return f'<div id="elements">{cells}</div>'


def first_shown(found: Elements, report: Report, heat: HeatMap) -> str:
    """Return the label of the first symptom that can be shown, else of the row with the largest ratio."""
    known = [one.label for one in found.of]
    told = [f"{s.channel} {s.element or ''}".strip() for s in report.where]
    peaks = sorted(
        zip(heat.ratio, heat.rows, strict=True), key=lambda row: -float(np.nan_to_num(row[0]).max(initial=0))
    )
    return next((label for label in (*told, *(name for _, name in peaks)) if label in known), known[0])


def _panel(one: Element, ids: tuple[str, ...], after: str, hidden: bool) -> str:
    """Return one element: its error in every episode, and the courses of some."""
    name = f"{words.plain(one.channel)} {one.element}".strip()
    return (
        f'<section class="panel" data-element="{escape(one.label)}"{" hidden" if hidden else ""}>'
        f"<h3>{escape(words.capital(name))}: every held-out episode</h3>"
        f"{_scatter(one, ids, after)}{''.join(_course(one, c, ids) for c in one.courses)}</section>"
    )


def _scatter(one: Element, ids: tuple[str, ...], after: str) -> str:
    """Return the mean error in each episode, worst first, nominal and repaired, beside what noise alone gives."""
    order = np.argsort(-np.nan_to_num(one.before, nan=-1.0), kind="stable")
    if len(order) > MOST_DOTS:
        order = order[np.linspace(0, len(order) - 1, MOST_DOTS).round().astype(int)]
    unit, factor = _small(one)
    null, before = (listing(factor * values[order]) for values in (one.null, one.before))
    repaired = [] if one.after is None else listing(factor * one.after[order])
    place = [float(k) for k in range(1, len(order) + 1)]
    x = Axis(0.4, len(order) + 0.6, ())
    y = linear([*null, *before, *repaired], 3, around=(0.0,))

    def tip(kind: str, values: list[float], k: int) -> str:
        return f"{ids[order[k]]}, {kind}: {digits(values[k])} {unit}"

    marks = dots(x, y, place, null, "null")
    marks += dots(x, y, place, before, "before", lambda k: tip("nominal", before, k))
    if repaired:
        marks += dots(x, y, place, repaired, "after", lambda k: tip(after, repaired, k))
    left = f" ({len(order)} of {len(ids)} drawn)" if len(order) < len(ids) else ""
    title = f"each held-out episode, worst first{left}"
    return chart(x, y, marks, f"mean error of {one.label} by episode", 120, title, f"mean error [{unit}]")


def _course(one: Element, course: Course, ids: tuple[str, ...]) -> str:
    """Return recorded, nominal and repaired values over one episode."""
    values = [course.real, course.before] + ([] if course.after is None else [course.after])
    x = linear(listing(course.time_s), 5, " s")
    y = linear([v for part in values for v in listing(part)], 3)
    marks = "".join(
        line(x, y, listing(course.time_s), listing(part), kind)
        for part, kind in zip(values, ("recorded", "before", "after"), strict=False)
    )
    unit = f" [{one.unit}]" if one.unit else ""
    drawn = chart(x, y, marks, f"{one.label} over {ids[course.episode]}", 84)
    return f'<div class="course"><p>{escape(ids[course.episode])}<small>{escape(unit)}</small></p>{drawn}</div>'


def _small(one: Element) -> tuple[str, float]:
    """Return the unit in which the element's errors read best, and the factor to it."""
    largest = float(np.nanmax(np.nan_to_num(one.before), initial=0.0))
    return SMALL[one.unit] if one.unit in SMALL and largest < 0.5 else (one.unit, 1.0)
