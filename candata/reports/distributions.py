"""Histograms of every element of every channel, as small multiples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape

from candata.datasets.histograms import Distribution
from candata.datasets.survey import ChannelDistribution
from candata.reports.chart import PLANE, Axis, chart, linear
from candata.reports.joint_units import readable
from candata.reports.numbers import digits, percent
from candata.schema.channels import CHANNELS

#: Elements drawn of one channel; a hand has fewer.
MOST_ELEMENTS = 64
#: Values that differ by no more than this share of themselves are one value to a reader.
ALIKE = 1e-6
#: From this share on, values that are exactly zero are said in words: their bar would dwarf all others.
MANY_ZEROS = 0.1


def distributions(found: Iterable[ChannelDistribution], units: Mapping[str, str]) -> str:
    """Return the histograms channel by channel; `units` as `joint_units` gives them."""
    by_channel: dict[str, list[ChannelDistribution]] = {}
    for one in found:
        by_channel.setdefault(one.channel, []).append(one)
    return "".join(_channel(name, members, units) for name, members in by_channel.items())


def _channel(name: str, members: list[ChannelDistribution], units: Mapping[str, str]) -> str:
    """Return the histograms of one channel."""
    cells = "".join(_element(one, units) for one in members[:MOST_ELEMENTS])
    more = len(members) - MOST_ELEMENTS
    note = f'<p class="note">{more} more elements are not drawn.</p>' if more > 0 else ""
    return (
        f'<section class="channel"><h3>{escape(name)}</h3><p class="sub">{escape(CHANNELS[name].meaning)}</p>'
        f'<div class="multiples">{cells}</div>{note}</section>'
    )


def _element(one: ChannelDistribution, units: Mapping[str, str]) -> str:
    """Return one histogram under its name."""
    unit = readable(one.element.unit, one.element.name, units)
    title = escape(one.element.name or one.channel)
    if one.distribution is None:
        return f"<div><p>{title}</p>{_words('no valid value')}</div>"
    return f"<div><p>{title}</p>{histogram(one.distribution, unit, one.element.name or one.channel)}</div>"


def histogram(found: Distribution, unit: str, label: str) -> str:
    """Return the bars of one distribution, with its range and what the bars leave out in words."""
    if found.high - found.low <= ALIKE * max(abs(found.low), abs(found.high)):
        about = "" if found.low == found.high else ", to one part in a million"
        return _words(f"always {digits(found.low)} {unit}".strip() + about)
    shares, zeros = found.shares.copy(), found.zero_share >= MANY_ZEROS
    if zeros:
        inside = (found.edges[:-1] <= 0) & (found.edges[1:] > 0)
        shares[inside] -= found.zero_share
    x = linear([found.edges[0], found.edges[-1]], 3)
    top = max(float(shares.max()), 1e-12)
    y = Axis(0, 1.08 * top, ((0.0, "0"), (top, percent(top))))
    marks = bars(x, y, found.edges.tolist(), shares.tolist(), "histo")
    words = f"{digits(found.low)} to {digits(found.high)} {unit}".strip()
    words += f"; exactly 0 in {percent(found.zero_share)}, not drawn" if zeros else ""
    return chart(x, y, marks, f"distribution of {label}", 62, unit, "share") + _words(words)


def bars(x: Axis, y: Axis, edges: list[float], shares: list[float], kind: str) -> str:
    """Return the outline of touching bars as one path; `kind` is its class."""
    across = [round(PLANE * x.share(v)) for v in edges]
    down = [round(PLANE * (1 - y.share(v))) for v in shares]
    steps = "".join(f"V{d}H{a}" for d, a in zip(down, across[1:], strict=True))
    return f'<path class="{kind}" d="M{across[0]} {PLANE}{steps}V{PLANE}"/>'


def _words(text: str) -> str:
    """Return a line below a histogram."""
    return f'<p class="sub small">{escape(text)}</p>'
