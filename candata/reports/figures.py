"""The figures of a diagnosis: ranking, before and after, every episode, courses of the example."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from candata.gap.verdict.figures import EpisodeLosses, Range, Trace
from candata.reports import words
from candata.reports.chart import (
    Axis,
    band,
    chart,
    dots,
    floats,
    join_markup,
    line,
    linear_axis,
    log_axis,
    mark,
    plane,
    span,
    upright_rule,
)
from candata.reports.document import render
from candata.reports.numbers import digits, percent
from candata.schema.report import Estimate, Gap, RankedEffect, Report

#: Candidates drawn in the ranking.
MOST_RANKED = 12
#: Elements drawn of an effect that was tried on several.
MOST_VARIANTS = 2
#: Points drawn of a trace; more cannot be seen at the size shown.
MOST_POINTS = 400
#: Episodes from which on dots are smaller.
CROWDED_FROM = 60
#: Steps between the ticks of an axis that counts episodes.
COUNT_STEPS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 10**6)


@dataclass(frozen=True)
class CandidateRow:
    """A candidate of the ranking: its gain as a drawing, its support, and its share when it is named."""

    name: str
    is_named: bool
    gain: Markup
    support: float
    share: str


def candidates(report: Report) -> Markup:
    """Return the best candidates with held-out gain, 90 % interval, support and share; named ones stand out."""
    shares = {(effect.name, effect.element): effect.share for effect in report.effects}
    best_candidates = drawn_candidates(report)
    ends = [v for c in best_candidates for v in (c.held_out_gain, c.gain_low, c.gain_high) if v is not None]
    x = linear_axis(ends, 3, include=(0.0,))
    rows = [
        _candidate_row(candidate, shares.get((candidate.name, candidate.element)), x) for candidate in best_candidates
    ]
    ticks = [(f"{100 * x.share(value):.1f}", text) for value, text in x.ticks]
    undrawn_count = sum(not candidate.reason for candidate in report.ranking) - len(best_candidates)
    return render("candidates", rows=rows, ticks=ticks, undrawn_count=undrawn_count)


def _candidate_row(candidate: RankedEffect, share: float | None, x: Axis) -> CandidateRow:
    """Return one candidate; `share` is None for one that is not named."""
    css_class, y = "" if share is None else "named", Axis(0, 1)
    reason = f"; {words.readable_name(candidate.reason)}" if candidate.reason else ""
    tooltip = f"gain {digits(candidate.held_out_gain)}{reason}"
    marks = [upright_rule(x, 0.0, "zero")]
    if candidate.gain_low is not None and candidate.gain_high is not None:
        marks.append(span(x, y, (candidate.gain_low, candidate.gain_high), 0.5, css_class))
    marks.append(dots(x, y, [candidate.held_out_gain], [0.5], css_class or "quiet", lambda _: tooltip))
    return CandidateRow(
        name=words.effect_title(candidate.name, candidate.element),
        is_named=share is not None,
        gain=plane(join_markup(marks)),
        support=candidate.support,
        share="" if share is None else percent(share),
    )


def drawn_candidates(report: Report) -> list[RankedEffect]:
    """Return the best candidates that were tested, each effect on few of its elements, and those that are named."""
    named_keys = {(effect.name, effect.element) for effect in report.effects}
    candidates_tested = [c for c in report.ranking if not c.reason or (c.name, c.element) in named_keys]
    variants = Counter[str]()
    best_ranked: list[RankedEffect] = []
    for candidate in candidates_tested:
        variants[candidate.name] += 1
        if variants[candidate.name] <= MOST_VARIANTS and len(best_ranked) < MOST_RANKED:
            best_ranked.append(candidate)
    return [c for c in candidates_tested if c in best_ranked or (c.name, c.element) in named_keys]


def mismatch_bars(gap: Gap, repair: str | None) -> Markup:
    """Return the mean mismatch before, after and of the floor as bars, in floors.

    `repair` names the simulation after the fit; None when no effect was tried.
    """
    bars = [("nominal", gap.before, "before"), ("floor", gap.floor, "floor")]
    if repair is not None:
        bars.insert(1, (repair, gap.after, "after"))
    top = max(value for _, value, _ in bars)
    return render("mismatch_bars", bars=[(name, css, 100 * value / top, value) for name, value, css in bars])


def losses(values: EpisodeLosses, repair: str | None = "repaired") -> Markup:
    """Return each held-out episode's mismatch before and after beside the floor's band, worst last.

    `repair` names the simulation after the fit; None when no effect was tried.
    """
    order = np.argsort(values.before, kind="stable")
    places = [float(k) for k in range(1, len(order) + 1)]
    nominal, repaired_losses, low, high = (
        floats(np.asarray(v)[order]) for v in (values.before, values.after, values.floor_low, values.floor_high)
    )
    x = Axis(0.4, len(order) + 0.6, _count_ticks(len(order)))
    y = log_axis([*nominal, *low, *high, *(repaired_losses if repair else [])], "×")

    def tooltip(name: str, mismatches: list[float], k: int) -> str:
        return f"{values.ids[order[k]]}, {name}: {words.times_floor(mismatches[k])}"

    size_class = " many" if len(order) > CROWDED_FROM else ""
    marks = [band(x, y, low, high)]
    marks.append(dots(x, y, places, nominal, f"before{size_class}", lambda k: tooltip("nominal", nominal, k)))
    if repair:
        marks.append(
            dots(x, y, places, repaired_losses, f"after{size_class}", lambda k: tooltip(repair, repaired_losses, k))
        )
    label, x_title = "mismatch of each held-out episode", "held-out episode, by mismatch before"
    return chart(x, y, join_markup(marks), label, 230, x_title, "mismatch over its floor")


def trace(time_s: np.ndarray, course: Trace) -> Markup:
    """Return recorded, nominal and repaired values of one element over time."""
    step = max(1, math.ceil(len(time_s) / MOST_POINTS))
    parts = {"recorded": course.real, "before": course.before}
    parts |= {} if course.after is None else {"after": course.after}
    times = floats(np.asarray(time_s)[::step])
    values = {css_class: floats(np.asarray(part)[::step]) for css_class, part in parts.items()}
    x, y = linear_axis(times, 6, " s"), linear_axis([v for part in values.values() for v in part], 4)
    marks = join_markup(line(x, y, times, part, css_class) for css_class, part in values.items())
    return chart(x, y, marks, f"{course.channel} {course.element} over time", 120)


def parameter_range(estimate: Estimate, search_range: Range | None) -> Markup:
    """Return the value and its interval in the range that was searched; empty for choices and vectors.

    An interval of which one end is not known goes to the end of that range.
    """
    is_number = isinstance(estimate.value, float | int)
    if search_range is None or not is_number or search_range.high <= search_range.low:
        return Markup("")
    log = search_range.low > 0 and search_range.high / search_range.low > 10
    x, y = Axis(search_range.low, search_range.high, log=log), Axis(0, 1)
    marks = [mark("grid", "M0 500H1000M0 250V750M1000 250V750")]
    if search_range.identity is not None:
        marks.append(mark("grid", f"M{x.x_place(max(search_range.identity, search_range.low))} 250V750"))
    if estimate.bounded is not None:
        low, high = (
            float(end) if isinstance(end, float | int) else range_end
            for end, range_end in ((estimate.low, search_range.low), (estimate.high, search_range.high))
        )
        marks.append(span(x, y, (low, high), 0.5, "named"))
    marks.append(dots(x, y, [float(estimate.value)], [0.5], "named"))  # type: ignore[arg-type]
    return Markup('<span class="range">{}</span>').format(plane(join_markup(marks)))


def _count_ticks(count: int) -> tuple[tuple[float, str], ...]:
    """Return ticks at whole numbers of episodes."""
    least_step = max(1, math.ceil(count / 8))
    step = next(s for s in COUNT_STEPS if s >= least_step)
    return tuple((float(k), str(k)) for k in range(step, count + 1, step))
