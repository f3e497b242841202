"""Charts as HTML around an SVG that stretches: text keeps its size at any width, colours follow the page's theme.

No script draws anything, so a chart is there in print, in mail and where scripts are off. Marks are paths in a plane of
1000 by 1000 units; their strokes do not scale, so that a stroke of no length is a round dot at any width.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from candata.reports.numbers import digits

#: Units of the plane in which marks are drawn, along both axes.
PLANE = 1000
#: Steps between ticks, times a power of ten.
NICE = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class Axis:
    """Range of an axis, and its ticks with their texts."""

    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]
    log: bool = False

    def share(self, value: float) -> float:
        """Return how far along the axis a value lies, 0 to 1 inside it."""
        if self.log:
            return math.log(max(value, 1e-12) / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


def linear(values: Iterable[float], count: int = 5, unit: str = "", around: Iterable[float] = ()) -> Axis:
    """Return an axis over the finite values and those it must show, with about `count` round ticks."""
    finite = [v for v in (*values, *around) if math.isfinite(v)] or [0.0]
    low, high = min(finite), max(finite)
    if high - low < 1e-9 * max(abs(low), abs(high), 1e-9):
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    step = _nice((high - low) / max(count, 1))
    margin = 0.03 * (high - low)
    first, last = math.ceil((low - margin) / step), math.floor((high + margin) / step)
    ticks = tuple((k * step, f"{digits(k * step)}{unit}") for k in range(first, last + 1))
    return Axis(low - margin, high + margin, ticks)


def logarithmic(values: Iterable[float], unit: str = "") -> Axis:
    """Return a logarithmic axis over the finite positive values, with ticks at 1, 2 and 5."""
    finite = [v for v in values if math.isfinite(v) and v > 0] or [1.0]
    low, high = min(finite) / 1.15, max(finite) * 1.15
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    every = [m * 10.0**k for k in powers for m in (1, 2, 5) if low <= m * 10.0**k <= high]
    kept = every if len(every) <= 7 else [v for v in every if f"{v:e}"[0] == "1"]
    return Axis(low, high, tuple((v, f"{digits(v)}{unit}") for v in kept), log=True)


def chart(x: Axis, y: Axis, marks: str, label: str, height_px: int, x_title: str = "", y_title: str = "") -> str:
    """Return a chart with its grid and ticks; `label` says to those who cannot see it what it shows."""
    lines = "".join(f"M0 {_down(y, v)}H{PLANE}" for v, _ in y.ticks)
    ups = "".join(f'<span class="yt" style="top:{100 - 100 * y.share(v):.1f}%">{escape(t)}</span>' for v, t in y.ticks)
    alongs = "".join(f'<span class="xt" style="left:{100 * x.share(v):.1f}%">{escape(t)}</span>' for v, t in x.ticks)
    caption = f'<span class="yl">{escape(y_title)}</span>' if y_title else ""
    below = f'<span class="xl">{escape(x_title)}</span>' if x_title else ""
    kinds = "chart" + (" titled" if x_title else "") + (" bare" if not y.ticks else "")
    return (
        f'<div class="{kinds}" role="img" aria-label="{escape(label)}">{caption}'
        f'<div class="plot" style="height:{height_px}px">{plane(f"""<path class="grid" d="{lines}"/>{marks}""")}'
        f"{ups}{alongs}</div>{below}</div>"
    )


def plane(marks: str) -> str:
    """Return the stretching drawing around some marks."""
    return f'<svg viewBox="0 0 {PLANE} {PLANE}" preserveAspectRatio="none" aria-hidden="true">{marks}</svg>'


def line(x: Axis, y: Axis, xs: Sequence[float], ys: Sequence[float], kind: str) -> str:
    """Return a line through the finite points, broken where one is missing; `kind` is its class.

    A point between two breaks is a stroke of no length, which a round cap shows.
    """
    strokes: list[list[str]] = []
    pen: tuple[int, int] | None = None
    for a, b in zip(xs, ys, strict=True):
        if not (math.isfinite(a) and math.isfinite(b)):
            pen = None
            continue
        here = (_along(x, a), _down(y, b))
        if pen is None:
            strokes.append([f"M{here[0]} {here[1]}"])
        else:
            strokes[-1].append(f"l{here[0] - pen[0]} {here[1] - pen[1]}")
        pen = here
    steps = ["".join(stroke) if len(stroke) > 1 else f"{stroke[0]}h0" for stroke in strokes]
    return f'<path class="line {kind}" d="{"".join(steps)}"/>' if steps else ""


def dots(
    x: Axis, y: Axis, xs: Sequence[float], ys: Sequence[float], kind: str, name: Callable[[int], str] | None = None
) -> str:
    """Return a dot at every finite point; `name` gives the text that shows when one is pointed at."""
    out = []
    for k, (a, b) in enumerate(zip(xs, ys, strict=True)):
        if math.isfinite(a) and math.isfinite(b):
            tip = f"<title>{escape(name(k))}</title>" if name else ""
            out.append(f'<path d="M{_along(x, a)} {_down(y, b)}h0">{tip}</path>')
    return f'<g class="dots {kind}">{"".join(out)}</g>' if out else ""


def span(x: Axis, y: Axis, ends: tuple[float, float], at: float, kind: str) -> str:
    """Return a level stroke from one value to another at the height `at`."""
    low, high = (_along(x, v) for v in ends)
    return f'<path class="span {kind}" d="M{low} {_down(y, at)}H{max(high, low + 1)}"/>'


def rule(axis: Axis, value: float, upright: bool, kind: str) -> str:
    """Return a line across the whole chart at a value of one axis."""
    d = f"M{_along(axis, value)} 0V{PLANE}" if upright else f"M0 {_down(axis, value)}H{PLANE}"
    return f'<path class="rule {kind}" d="{d}"/>'


def band(x: Axis, y: Axis, low: Sequence[float], high: Sequence[float]) -> str:
    """Return an area between two values, one step wide around each of the places 1, 2, ..."""
    top, bottom = [], []
    for k, (a, b) in enumerate(zip(low, high, strict=True), start=1):
        if math.isfinite(a) and math.isfinite(b):
            for edge in (k - 0.5, k + 0.5):
                top.append(f"{_along(x, edge)} {_down(y, b)}")
                bottom.append(f"{_along(x, edge)} {_down(y, a)}")
    return f'<path class="band" d="M{"L".join((*top, *reversed(bottom)))}Z"/>' if top else ""


def listing(values: NDArray[np.float64] | Sequence[float] | None) -> list[float]:
    """Return numbers as a list of floats; nothing for None."""
    return [] if values is None else [float(v) for v in values]


def _nice(step: float) -> float:
    """Return the next round step that is no smaller."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(n * power for n in NICE if n * power >= step * 0.999)


def _along(x: Axis, value: float) -> int:
    """Return the place of a value along the plane, never far outside."""
    return round(PLANE * min(max(x.share(value), -0.05), 1.05))


def _down(y: Axis, value: float) -> int:
    """Return the place of a value down the plane, never far outside."""
    return round(PLANE * (1 - min(max(y.share(value), -0.05), 1.05)))
