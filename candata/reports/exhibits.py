"""The episodes of each element, hidden until its row of the heat map is clicked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from candata.gap.measure.symptoms import HeatMap
from candata.gap.verdict.figures import Course, Element, Elements
from candata.reports import words
from candata.reports.chart import Axis, chart, dots, floats, join_markup, line, linear_axis
from candata.reports.document import render
from candata.reports.numbers import digits
from candata.schema.report import Report

#: Episodes drawn as dots; when there are more, some are left out evenly from the worst to the best.
MOST_DOTS = 40
#: SI unit to the unit of a small residual and the factor to it.
SMALL_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "N": ("mN", 1e3)}
#: Residuals below this SI value are shown in the small unit.
SMALL_BELOW = 0.5


@dataclass(frozen=True)
class Panel:
    """What the page shows of one element: its error in every episode, and its courses over some of them."""

    label: str
    name: str
    unit: str
    is_open: bool
    scatter: Markup
    courses: tuple[tuple[str, Markup], ...]


def panels(elements: Elements, open_label: str, repair: str) -> Markup:
    """Return a panel for each element, the one with the label `open_label` in sight.

    `repair` names the repaired simulation.
    """
    return render("panels", panels=[_panel(element, elements.ids, repair, open_label) for element in elements.of])


def most_telling_label(elements: Elements, report: Report, heat: HeatMap) -> str:
    """Return the label of the first symptom that has a panel, else of the row with the largest ratio."""
    labels = [element.label for element in elements.of]
    symptoms = [f"{symptom.channel} {symptom.element or ''}".strip() for symptom in report.where]
    by_ratio = sorted(
        zip(heat.ratio, heat.rows, strict=True), key=lambda row: -float(np.nan_to_num(row[0]).max(initial=0))
    )
    candidates = (*symptoms, *(label for _, label in by_ratio))
    return next((label for label in candidates if label in labels), labels[0])


def _panel(element: Element, ids: tuple[str, ...], repair: str, open_label: str) -> Panel:
    """Return the panel of one element."""
    return Panel(
        label=element.label,
        name=words.sentence_case(f"{words.readable_name(element.channel)} {element.element}".strip()),
        unit=element.unit,
        is_open=element.label == open_label,
        scatter=_scatter(element, ids, repair),
        courses=tuple((ids[course.episode], _course(element, course, ids)) for course in element.courses),
    )


def _scatter(element: Element, ids: tuple[str, ...], repair: str) -> Markup:
    """Return the mean error in each episode, worst first, nominal and repaired, beside what noise alone gives."""
    order = np.argsort(-np.nan_to_num(element.before, nan=-1.0), kind="stable")
    if len(order) > MOST_DOTS:
        order = order[np.linspace(0, len(order) - 1, MOST_DOTS).round().astype(int)]
    unit, factor = _error_unit(element)
    null, nominal = (floats(factor * values[order]) for values in (element.null, element.before))
    repaired_errors = [] if element.after is None else floats(factor * element.after[order])
    places = [float(k) for k in range(1, len(order) + 1)]
    x = Axis(0.4, len(order) + 0.6)
    y = linear_axis([*null, *nominal, *repaired_errors], 3, include=(0.0,))

    def tooltip(name: str, errors: list[float], k: int) -> str:
        return f"{ids[order[k]]}, {name}: {digits(errors[k])} {unit}"

    marks = [dots(x, y, places, null, "null")]
    marks.append(dots(x, y, places, nominal, "before", lambda k: tooltip("nominal", nominal, k)))
    if repaired_errors:
        marks.append(dots(x, y, places, repaired_errors, "after", lambda k: tooltip(repair, repaired_errors, k)))
    count = f" ({len(order)} of {len(ids)} drawn)" if len(order) < len(ids) else ""
    title = f"each held-out episode, worst first{count}"
    return chart(
        x, y, join_markup(marks), f"mean error of {element.label} by episode", 120, title, f"mean error [{unit}]"
    )


def _course(element: Element, course: Course, ids: tuple[str, ...]) -> Markup:
    """Return recorded, nominal and repaired values over one episode."""
    values = [course.real, course.before] + ([] if course.after is None else [course.after])
    x = linear_axis(floats(course.time_s), 5, " s")
    y = linear_axis([value for part in values for value in floats(part)], 3)
    marks = join_markup(
        line(x, y, floats(course.time_s), floats(part), css_class)
        for part, css_class in zip(values, ("recorded", "before", "after"), strict=False)
    )
    return chart(x, y, marks, f"{element.label} over {ids[course.episode]}", 84)


def _error_unit(element: Element) -> tuple[str, float]:
    """Return the unit in which the element's errors read best, and the factor to it."""
    largest_error = float(np.nanmax(np.nan_to_num(element.before), initial=0.0))
    return (
        SMALL_UNITS[element.unit]
        if element.unit in SMALL_UNITS and largest_error < SMALL_BELOW
        else (element.unit, 1.0)
    )
