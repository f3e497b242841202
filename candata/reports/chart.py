"""Charts as HTML around an SVG that stretches: text keeps its size at any width, colours follow the page's theme.

No script draws anything, so a chart is there in print, in mail and where scripts are off. Marks are paths in a plane of
1000 by 1000 units; their strokes do not scale, so that a stroke of no length is a round dot at any width.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from candata.reports.document import render
from candata.reports.numbers import digits

#: Units of the plane in which marks are drawn, along both axes.
PLANE = 1000
#: How far outside of the plane a mark may lie, as a share of it.
OVERHANG = 0.05
#: Steps between ticks, times a power of ten.
ROUND_STEPS = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class Axis:
    """Range of an axis, and its ticks with their texts."""

    low: float
    high: float
    ticks: tuple[tuple[float, str], ...] = ()
    log: bool = False

    def share(self, value: float) -> float:
        """Return how far along the axis a value lies, 0 to 1 inside it."""
        if self.log:
            return math.log(max(value, 1e-12) / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def x_place(self, value: float) -> int:
        """Return the place of a value along the plane from its left edge, never far outside."""
        return round(PLANE * min(max(self.share(value), -OVERHANG), 1 + OVERHANG))

    def y_place(self, value: float) -> int:
        """Return the place of a value down the plane from its upper edge, never far outside."""
        return round(PLANE * (1 - min(max(self.share(value), -OVERHANG), 1 + OVERHANG)))


def linear_axis(values: Iterable[float], tick_count: int = 5, unit: str = "", include: Iterable[float] = ()) -> Axis:
    """Return an axis over the finite values and those of `include`, with about `tick_count` round ticks."""
    finite = [v for v in (*values, *include) if math.isfinite(v)] or [0.0]
    low, high = min(finite), max(finite)
    if high - low < 1e-9 * max(abs(low), abs(high), 1e-9):
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    step = _round_step((high - low) / max(tick_count, 1))
    margin = 0.03 * (high - low)
    start, stop = math.ceil((low - margin) / step), math.floor((high + margin) / step)
    ticks = tuple((k * step, f"{digits(k * step)}{unit}") for k in range(start, stop + 1))
    return Axis(low - margin, high + margin, ticks)


def log_axis(values: Iterable[float], unit: str = "") -> Axis:
    """Return a logarithmic axis over the finite positive values, with ticks at 1, 2 and 5."""
    finite = [v for v in values if math.isfinite(v) and v > 0] or [1.0]
    low, high = min(finite) / 1.15, max(finite) * 1.15
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    tick_values = [m * 10.0**k for k in powers for m in (1, 2, 5) if low <= m * 10.0**k <= high]
    if len(tick_values) > 7:
        tick_values = [v for v in tick_values if f"{v:e}"[0] == "1"]
    return Axis(low, high, tuple((v, f"{digits(v)}{unit}") for v in tick_values), log=True)


def chart(x: Axis, y: Axis, marks: Markup, label: str, height_px: int, x_title: str = "", y_title: str = "") -> Markup:
    """Return a chart with its grid and ticks; `label` says to those who cannot see it what it shows."""
    return render(
        "chart", x=x, y=y, marks=marks, label=label, height_px=height_px, x_title=x_title, y_title=y_title, plane=plane
    )


def plane(marks: Markup) -> Markup:
    """Return the stretching drawing around some marks."""
    size = f"0 0 {PLANE} {PLANE}"
    return Markup('<svg viewBox="{}" preserveAspectRatio="none" aria-hidden="true">{}</svg>').format(size, marks)


def join_markup(parts: Iterable[Markup]) -> Markup:
    """Return pieces of markup as one."""
    return Markup("").join(parts)


def line(x: Axis, y: Axis, xs: Sequence[float], ys: Sequence[float], css_class: str) -> Markup:
    """Return a line through the finite points, broken where one is missing.

    A point between two breaks is a stroke of no length, which a round cap shows.
    """
    strokes: list[list[str]] = []
    pen: tuple[int, int] | None = None
    for x_value, y_value in zip(xs, ys, strict=True):
        if not (math.isfinite(x_value) and math.isfinite(y_value)):
            pen = None
            continue
        place = (x.x_place(x_value), y.y_place(y_value))
        if pen is None:
            strokes.append([f"M{place[0]} {place[1]}"])
        else:
            strokes[-1].append(f"l{place[0] - pen[0]} {place[1] - pen[1]}")
        pen = place
    steps = ["".join(stroke) if len(stroke) > 1 else f"{stroke[0]}h0" for stroke in strokes]
    return mark(f"line {css_class}", "".join(steps)) if steps else Markup("")


def dots(
    x: Axis,
    y: Axis,
    xs: Sequence[float],
    ys: Sequence[float],
    css_class: str,
    tooltip: Callable[[int], str] | None = None,
) -> Markup:
    """Return a dot at every finite point; `tooltip` gives the text that shows when one is pointed at."""
    paths = [
        Markup('<path d="M{} {}h0">{}</path>').format(
            x.x_place(x_value), y.y_place(y_value), _title(tooltip(k)) if tooltip else ""
        )
        for k, (x_value, y_value) in enumerate(zip(xs, ys, strict=True))
        if math.isfinite(x_value) and math.isfinite(y_value)
    ]
    return Markup('<g class="dots {}">{}</g>').format(css_class, join_markup(paths)) if paths else Markup("")


def span(x: Axis, y: Axis, ends: tuple[float, float], height: float, css_class: str) -> Markup:
    """Return a level stroke from one value to another at a height on the other axis."""
    low, high = (x.x_place(v) for v in ends)
    return mark(f"span {css_class}", f"M{low} {y.y_place(height)}H{max(high, low + 1)}")


def upright_rule(x: Axis, value: float, css_class: str) -> Markup:
    """Return a line from the bottom to the top of the chart at a value of the x axis."""
    return mark(f"rule {css_class}", f"M{x.x_place(value)} 0V{PLANE}")


def band(x: Axis, y: Axis, low: Sequence[float], high: Sequence[float]) -> Markup:
    """Return an area between two values, one step wide around each of the places 1, 2, ..."""
    top, bottom = [], []
    for k, (low_value, high_value) in enumerate(zip(low, high, strict=True), start=1):
        if math.isfinite(low_value) and math.isfinite(high_value):
            for edge in (k - 0.5, k + 0.5):
                top.append(f"{x.x_place(edge)} {y.y_place(high_value)}")
                bottom.append(f"{x.x_place(edge)} {y.y_place(low_value)}")
    return mark("band", f"M{'L'.join((*top, *reversed(bottom)))}Z") if top else Markup("")


def areas(x: Axis, spans: Iterable[tuple[float, float]], css_class: str) -> Markup:
    """Return areas from the bottom to the top of the chart, one over each span of the x axis; empty for none."""
    places = ((x.x_place(low), x.x_place(high)) for low, high in spans)
    steps = "".join(f"M{low} 0H{max(high, low + 1)}V{PLANE}H{low}Z" for low, high in places)
    return mark(css_class, steps) if steps else Markup("")


def tooltip_strips(x: Axis, xs: Sequence[float], tooltips: Sequence[str]) -> Markup:
    """Return unseen upright strips, each around one of the increasing places `xs`, that show a text when pointed at."""
    edges = [-math.inf, *((a + b) / 2 for a, b in pairwise(xs)), math.inf]
    strips = (
        Markup('<path d="M{} 0H{}V{}H{}Z">{}</path>').format(low, high, PLANE, low, _title(text))
        for text, low, high in zip(tooltips, map(x.x_place, edges[:-1]), map(x.x_place, edges[1:]), strict=True)
    )
    return Markup('<g class="strips">{}</g>').format(join_markup(strips))


def mark(css_class: str, steps: str) -> Markup:
    """Return a path of a class; `steps` is its `d` attribute."""
    return Markup('<path class="{}" d="{}"/>').format(css_class, steps)


def floats(values: NDArray[np.float64] | Sequence[float] | None) -> list[float]:
    """Return numbers as a list of floats; an empty one for None."""
    return [] if values is None else [float(v) for v in values]


def _title(text: str) -> Markup:
    """Return the element that holds the text shown when its parent is pointed at."""
    return Markup("<title>{}</title>").format(text)


def _round_step(step: float) -> float:
    """Return the next round step that is no smaller."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(n * power for n in ROUND_STEPS if n * power >= step * 0.999)
