"""The page of two datasets side by side: what differs most, drawn, then every statistic in one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from markupsafe import Markup

from candata.datasets.compare import ComparisonResult, ComparisonRow, DatasetComparison, Side, Spread
from candata.datasets.distance import Bars
from candata.reports.chart import Axis, chart, join_markup, linear_axis
from candata.reports.distributions import bars
from candata.reports.document import render_page
from candata.reports.inspection import units_of
from candata.reports.joint_units import readable_unit
from candata.reports.numbers import digits, percent
from candata.reports.words import sentence_case

#: Distributions drawn: at least and at most; rows of the table; all are in the JSON record.
LEAST_DRAWN, MOST_DRAWN, MOST_ROWS = 6, 24, 240
GROUPS = {"motion": "Motion", "force": "Force", "contact": "Contact timing", "following": "Following commands"}
DASH = "\N{EN DASH}"
#: What the words of the table mean.
METHOD = (
    ("distance", "Wasserstein's: how far, on average, values must be moved to turn one distribution into the other."),
    ("spreads", "The distance in standard deviations of both sides together, each side weighing the same; at most 2."),
    ("luck", "The distance that 95 % of random deals of the same episodes to two sides stay below."),
    (
        "beyond luck",
        "Bold: larger than what random deals reach anywhere in the table, at a chance of 1 in 20 for the whole table. "
        "Episodes are dealt whole, as rows of one episode are alike.",
    ),
    ("force, impulse", "Of fingertips in contact: size of the force vector; its sum over the time of each contact."),
    ("contact", "A contact cut off by the start or the end of an episode counts with the length that was seen."),
    (
        "command minus position",
        "At the end of the step that a command was held for, the root of the mean square of an episode.",
    ),
    (
        "lag",
        "Where changes of the position correlate most with changes of the command, up to 0.3 s; left out where they "
        "hardly do.",
    ),
)


@dataclass(frozen=True)
class DistributionPair:
    """Both distributions of a statistic: its name, the drawing (empty for a constant), and the distance in words."""

    title: str
    chart: Markup
    constant: str
    distance: str


@dataclass(frozen=True)
class StatisticRow:
    """A row of the table; `percent` is the length of the bar that shows the distance in spreads."""

    cells: tuple[str, ...]
    differs: bool
    percent: float


def page(pair: ComparisonResult) -> str:
    """Return the page as text."""
    comparison = pair.comparison
    sides = (comparison.this, comparison.against)
    units = units_of({scene for side in sides for scene in side.scenes})
    largest_spreads = max((row.spreads or 0.0 for row in comparison.rows), default=0.0) or 1.0
    return render_page(
        "comparison",
        title=" beside ".join(side.label for side in sides),
        tone="none",
        this=comparison.this,
        against=comparison.against,
        meaning=verdict(comparison),
        answers=[_answer(comparison, group, title, units) for group, title in GROUPS.items()],
        distributions=_distribution_pairs(pair, units),
        rows=[_statistic_row(row, units, largest_spreads) for row in comparison.rows[:MOST_ROWS]],
        unlisted_count=max(len(comparison.rows) - MOST_ROWS, 0),
        remarks=[sentence_case(text) for text in (*comparison.unmatched, *comparison.notes)],
        sides=[(f"{side.label}@{side.digest[:12]}", _side_words(side)) for side in sides],
        method=_method(comparison),
    )


def verdict(comparison: DatasetComparison) -> str:
    """Return in one sentence how many statistics differ by more than luck."""
    if any(row.differs is None for row in comparison.rows):
        counts = f"{comparison.this.compared} beside {comparison.against.compared}"
        return (
            f"Too few episodes to tell a difference from luck ({counts}); {len(comparison.rows)} statistics, by their "
            "distance."
        )
    count = sum(bool(row.differs) for row in comparison.rows)
    subject = "No statistic differs" if not count else f"{count} of {len(comparison.rows)} statistics differ"
    return f"{subject} by more than luck would make episodes of one world differ."


def row_unit(row: ComparisonRow, units: Mapping[str, str]) -> str:
    """Return the unit of a row as people read it."""
    return readable_unit(row.unit, row.element, units)


def _answer(comparison: DatasetComparison, group: str, title: str, units: Mapping[str, str]) -> tuple[str, str, str]:
    """Return the name of a group, how many of its statistics differ, and which differs most."""
    rows = [row for row in comparison.rows if row.group == group]
    if not rows:
        return title, DASH, "Not on both sides."
    farthest, count = rows[0], sum(bool(row.differs) for row in rows)
    medians = f"{digits(farthest.this.median)} beside {digits(farthest.against.median)} {row_unit(farthest, units)}"
    name = f"{farthest.statistic} {farthest.element}".strip()
    return title, f"{count} of {len(rows)} differ", f"Most: {name}, median {medians.strip()}."


def _distribution_pairs(pair: ComparisonResult, units: Mapping[str, str]) -> list[DistributionPair]:
    """Return the distributions of the first rows: those that differ, a few in any case."""
    rows = pair.comparison.rows
    count = min(max(LEAST_DRAWN, sum(bool(row.differs) for row in rows)), MOST_DRAWN)
    entries = list(zip(rows, pair.bars, strict=True))[:count]
    return [_distribution_pair(row, histograms, row_unit(row, units)) for row, histograms in entries]


def _distribution_pair(row: ComparisonRow, histograms: Bars, unit: str) -> DistributionPair:
    """Return both distributions of a row under its name."""
    title = f"{row.statistic} {row.element}".strip()
    distance = f"{digits(row.spreads)} spreads apart" if row.spreads is not None else "always the same"
    distance += ", beyond luck" if row.differs else ", within luck" if row.differs is False else ""
    if histograms.edges[0] == histograms.edges[-1]:
        return DistributionPair(title, Markup(""), f"always {digits(float(histograms.edges[0]))} {unit}", distance)
    top = float(max(histograms.this.max(), histograms.against.max()))
    x = linear_axis([histograms.edges[0], histograms.edges[-1]], 4)
    y = Axis(0, 1.06 * top, ((0.0, "0"), (top, percent(top))))
    sides = (("against", histograms.against), ("this", histograms.this))
    marks = join_markup(bars(x, y, histograms.edges.tolist(), v.tolist(), f"histo {side}") for side, v in sides)
    label = f"distributions of {row.statistic} {row.element}"
    return DistributionPair(title, chart(x, y, marks, label, 84, unit or "share", "share"), "", distance)


def _statistic_row(row: ComparisonRow, units: Mapping[str, str], largest_spreads: float) -> StatisticRow:
    """Return one row of the table."""
    cells = (
        row.statistic,
        row.element or DASH,
        row_unit(row, units) or DASH,
        _spread(row.this),
        _spread(row.against),
        digits(row.distance),
        DASH if row.luck is None else digits(row.luck),
        DASH if row.spreads is None else digits(row.spreads),
    )
    return StatisticRow(cells, bool(row.differs), 100 * (row.spreads or 0.0) / largest_spreads)


def _spread(spread: Spread) -> str:
    """Return `0.42 (0.1 to 0.9)`."""
    return f"{digits(spread.median)} ({digits(spread.low)} to {digits(spread.high)})"


def _side_words(side: Side) -> str:
    """Return what was read of one side."""
    rates = ", ".join(f"{rate:g} Hz" for rate in side.rates_hz)
    sources = ", ".join(f"{name} {count}" for name, count in sorted(side.sources.items()))
    scenes = ", ".join(sorted(side.scenes)) or "no scene stated"
    return (
        f"{side.compared} of {side.episodes} episodes, {side.rows:,} rows, {digits(side.duration_s)} s at {rates}; "
        f"{sources}; {scenes}"
    )


def _method(comparison: DatasetComparison) -> list[tuple[str, str]]:
    """Return what the words of the table mean."""
    derivatives = (
        f"By differences over {digits(1e3 * comparison.step_s)} ms on both sides, noise of the sensors included; noise "
        "may be most of an acceleration."
    )
    return [("speeds, accelerations", derivatives), *METHOD]
