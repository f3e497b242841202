"""The figures of the page: ranking, before and after, every episode, courses of the example."""

from __future__ import annotations

import math
from collections import Counter
from html import escape

import numpy as np

from candata.gap.evidence import EpisodeLosses, Range, Trace
from candata.reports import words
from candata.reports.chart import Axis, band, chart, dots, line, linear, listing, logarithmic, plane, rule, span
from candata.reports.numbers import digits, percent
from candata.schema.report import Estimate, Gap, RankedEffect, Report

#: Candidates drawn in the ranking.
MOST_RANKED = 12
#: Of an effect that was tried on several elements, this many are drawn.
MOST_VARIANTS = 2
#: Points drawn of a trace; more cannot be seen at the size shown.
MOST_POINTS = 400


def ranking(report: Report) -> str:
    """Return the best candidates with held-out gain, 90 % interval, support and share; named ones stand out."""
    shares = {(effect.name, effect.element): effect.share for effect in report.effects}
    shown = shown_candidates(report)
    ends = [v for c in shown for v in (c.held_out_gain, c.gain_low, c.gain_high) if v is not None]
    x, y = linear(ends, 3, around=(0.0,)), Axis(0, 1, ())
    rows = []
    for one in shown:
        key = (one.name, one.element)
        kind = "named" if key in shares else ""
        tip = f"gain {digits(one.held_out_gain)}" + (f"; {words.plain(one.reason)}" if one.reason else "")
        marks = rule(x, 0.0, True, "zero")
        if one.gain_low is not None and one.gain_high is not None:
            marks += span(x, y, (one.gain_low, one.gain_high), 0.5, kind)
        marks += dots(x, y, [one.held_out_gain], [0.5], kind or "quiet", lambda _, tip=tip: tip)  # type: ignore[misc]
        share = percent(shares[key]) if key in shares else ""
        rows.append(
            f'<tr class="{kind}"><th scope="row">{escape(words.title(one.name, one.element))}</th>'
            f'<td class="gain">{plane(marks)}</td><td class="n">{one.support:.2f}</td><td class="n">{share}</td></tr>'
        )
    ticks = "".join(f'<span class="xt" style="left:{100 * x.share(v):.1f}%">{t}</span>' for v, t in x.ticks)
    head = '<td></td><th scope="col">held-out gain</th><th class="n">support</th><th class="n">share</th>'
    return (
        f'<table class="rank"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody>'
        f'<tfoot><tr><td></td><td class="gain ticks">{ticks}</td><td></td><td></td></tr></tfoot></table>'
    )


def shown_candidates(report: Report) -> list[RankedEffect]:
    """Return the best candidates that were tested, each effect on few of its elements, and those that are named."""
    named = {(effect.name, effect.element) for effect in report.effects}
    tested = [c for c in report.ranking if not c.reason or (c.name, c.element) in named]
    met = Counter[str]()
    first: list[RankedEffect] = []
    for one in tested:
        met[one.name] += 1
        if met[one.name] <= MOST_VARIANTS and len(first) < MOST_RANKED:
            first.append(one)
    return [c for c in tested if c in first or (c.name, c.element) in named]


def how_far(gap: Gap, after: str | None) -> str:
    """Return the mean mismatch before, after (None: nothing was tried) and of the floor as bars, in floors."""
    bars = [("nominal", gap.before, "before")]
    if after is not None:
        bars.append((after, gap.after, "after"))
    bars.append(("floor", gap.floor, "floor"))
    top = max(value for _, value, _ in bars)
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td><i class="{kind}" style="width:{100 * value / top:.1f}%"></i></td>'
        f'<td class="n">{digits(value)}</td></tr>'
        for name, value, kind in bars
    )
    return f'<table class="bars"><tbody>{rows}</tbody></table>'


def losses(values: EpisodeLosses, name_after: str = "repaired", repaired: bool = True) -> str:
    """Return each held-out episode's mismatch before and after beside the floor's band, worst last."""
    order = np.argsort(values.before, kind="stable")
    place = [float(k) for k in range(1, len(order) + 1)]
    before, after, low, high = (
        listing(np.asarray(v)[order]) for v in (values.before, values.after, values.floor_low, values.floor_high)
    )
    shown = [*before, *low, *high, *(after if repaired else [])]
    x, y = Axis(0.4, len(order) + 0.6, _counting(len(order))), logarithmic(shown, "×")

    def tip(kind: str, found: list[float], k: int) -> str:
        return f"{values.ids[order[k]]}, {kind}: {words.times(found[k])}"

    many = " many" if len(order) > 60 else ""
    marks = band(x, y, low, high)
    marks += dots(x, y, place, before, "before" + many, lambda k: tip("nominal", before, k))
    if repaired:
        marks += dots(x, y, place, after, "after" + many, lambda k: tip(name_after, after, k))
    return chart(
        x, y, marks, "mismatch of each held-out episode", 230, "held-out episode, by mismatch before",
        "mismatch over its floor",
    )  # fmt: skip


def trace(time_s: np.ndarray, one: Trace) -> str:
    """Return recorded, nominal and repaired values of one element over time."""
    step = max(1, math.ceil(len(time_s) / MOST_POINTS))
    drawn = [("recorded", one.real), ("before", one.before)] + ([] if one.after is None else [("after", one.after)])
    time = listing(np.asarray(time_s)[::step])
    values = {kind: listing(np.asarray(part)[::step]) for kind, part in drawn}
    x, y = linear(time, 6, " s"), linear([v for part in values.values() for v in part], 4)
    marks = "".join(line(x, y, time, part, kind) for kind, part in values.items())
    return chart(x, y, marks, f"{one.channel} {one.element} over time", 120)


def parameter(estimate: Estimate, where: Range | None) -> str:
    """Return where the value and its interval lie in the range that was searched; empty for choices and vectors.

    An interval of which one end is not known goes to the end of that range.
    """
    if where is None or not isinstance(estimate.value, float | int) or where.high <= where.low:
        return ""
    log = where.low > 0 and where.high / where.low > 10
    x, y = Axis(where.low, where.high, (), log=log), Axis(0, 1, ())
    marks = '<path class="grid" d="M0 500H1000M0 250V750M1000 250V750"/>'
    if where.identity is not None:
        marks += f'<path class="grid" d="M{round(1000 * x.share(max(where.identity, where.low)))} 250V750"/>'
    if estimate.bounded is not None:
        low, high = (
            float(end) if isinstance(end, float | int) else bound
            for end, bound in ((estimate.low, where.low), (estimate.high, where.high))
        )
        marks += span(x, y, (low, high), 0.5, "named")
    marks += dots(x, y, [float(estimate.value)], [0.5], "named")
    return f'<span class="range">{plane(marks)}</span>'


def _counting(count: int) -> tuple[tuple[float, str], ...]:
    """Return ticks at whole numbers of episodes."""
    step = max(1, math.ceil(count / 8))
    step = next(s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 10**6) if s >= step)
    return tuple((float(k), str(k)) for k in range(step, count + 1, step))
