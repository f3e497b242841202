"""Histograms of every element of every channel, as small multiples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from markupsafe import Markup

from candata.datasets.histograms import Distribution
from candata.datasets.survey import ChannelDistribution
from candata.reports.chart import PLANE, Axis, chart, linear_axis, mark
from candata.reports.document import render
from candata.reports.joint_units import readable_unit
from candata.reports.numbers import digits, percent
from candata.schema.channels import CHANNELS

#: Elements drawn of one channel; a hand has fewer.
MOST_ELEMENTS = 64
#: Values that differ by no more than this share of themselves are one value to a reader.
EQUAL_SHARE = 1e-6
#: From this share on, values that are exactly zero are said in words: their bar would dwarf all others.
MANY_ZEROS = 0.1


@dataclass(frozen=True)
class HistogramFigure:
    """The distribution of one element: its bars, empty when it has one value or none, and its range in words."""

    title: str
    chart: Markup
    caption: str


@dataclass(frozen=True)
class ChannelHistograms:
    """The histograms of one channel, and how many elements have none as there are too many."""

    channel: str
    meaning: str
    histograms: tuple[HistogramFigure, ...]
    undrawn_count: int


def distributions(elements: Iterable[ChannelDistribution], units: Mapping[str, str]) -> Markup:
    """Return the histograms channel by channel; `units` as `joint_units` gives them."""
    by_channel: dict[str, list[ChannelDistribution]] = {}
    for element in elements:
        by_channel.setdefault(element.channel, []).append(element)
    channels = [
        ChannelHistograms(
            channel=name,
            meaning=CHANNELS[name].meaning,
            histograms=tuple(_histogram(member, units) for member in members[:MOST_ELEMENTS]),
            undrawn_count=max(len(members) - MOST_ELEMENTS, 0),
        )
        for name, members in by_channel.items()
    ]
    return render("distributions", channels=channels)


def _histogram(element: ChannelDistribution, units: Mapping[str, str]) -> HistogramFigure:
    """Return one histogram, with its range and what the bars leave out in words."""
    unit = readable_unit(element.element.unit, element.element.name, units)
    title, values = element.element.name or element.channel, element.distribution
    if values is None:
        return HistogramFigure(title, Markup(""), "no valid value")
    if values.high - values.low <= EQUAL_SHARE * max(abs(values.low), abs(values.high)):
        precision = "" if values.low == values.high else ", to one part in a million"
        return HistogramFigure(title, Markup(""), f"always {digits(values.low)} {unit}".strip() + precision)
    caption = f"{digits(values.low)} to {digits(values.high)} {unit}".strip()
    if values.zero_share >= MANY_ZEROS:
        caption += f"; exactly 0 in {percent(values.zero_share)}, not drawn"
    return HistogramFigure(title, _bars(values, unit, title), caption)


def _bars(values: Distribution, unit: str, title: str) -> Markup:
    """Return the bars of one distribution."""
    shares = values.shares.copy()
    if values.zero_share >= MANY_ZEROS:
        shares[(values.edges[:-1] <= 0) & (values.edges[1:] > 0)] -= values.zero_share
    top = max(float(shares.max()), 1e-12)
    x = linear_axis([values.edges[0], values.edges[-1]], 3)
    y = Axis(0, 1.08 * top, ((0.0, "0"), (top, percent(top))))
    marks = bars(x, y, values.edges.tolist(), shares.tolist(), "histo")
    return chart(x, y, marks, f"distribution of {title}", 62, unit, "share")


def bars(x: Axis, y: Axis, edges: list[float], shares: list[float], css_class: str) -> Markup:
    """Return the outline of touching bars as one path."""
    places = [x.x_place(value) for value in edges]
    steps = "".join(f"V{y.y_place(share)}H{place}" for share, place in zip(shares, places[1:], strict=True))
    return mark(css_class, f"M{places[0]} {PLANE}{steps}V{PLANE}")
