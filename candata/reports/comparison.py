"""The page of two datasets side by side: what differs most, drawn, then every statistic in one table."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from candata.datasets.compare import Comparison, ComparisonResult, ComparisonRow, Side, Spread
from candata.datasets.distance import Bars
from candata.reports.chart import Axis, chart, linear
from candata.reports.distributions import bars
from candata.reports.document import document
from candata.reports.inspection import units_of
from candata.reports.joint_units import readable
from candata.reports.numbers import digits, percent
from candata.reports.seeing_style import SEEING_STYLE
from candata.reports.tables import pairs

#: Distributions drawn, and rows of the table; all are in the JSON record.
MOST_DRAWN, MOST_ROWS = 24, 240
GROUPS = {"motion": "Motion", "force": "Force", "contact": "Contact timing", "following": "Following commands"}
DASH = "\N{EN DASH}"
_MANNER = (
    ("distance", "Wasserstein's: how far, on average, values must be moved to turn one distribution into the other."),
    ("spreads", "The distance in standard deviations of both sides together, each side weighing the same; at most 2."),
    ("luck", "The distance that 95 % of random deals of the same episodes to two sides stay below."),
    ("beyond luck", "Bold: larger than what random deals reach anywhere in the table, at a chance of 1 in 20 for the "
     "whole table. Episodes are dealt whole, as rows of one episode are alike."),
    ("force, impulse", "Of fingertips in contact: size of the force vector; its sum over the time of each contact."),
    ("contact", "A contact cut off by the start or the end of an episode counts with the length that was seen."),
    ("command minus position", "At the end of the step that a command was held for, the root of the mean square of an "
     "episode."),
    ("lag", "Where changes of the position correlate most with changes of the command, up to 0.3 s; left out where "
     "they hardly do."),
)  # fmt: skip


def page(found: ComparisonResult) -> str:
    """Return the page as text."""
    one = found.comparison
    units = units_of({*one.this.scenes, *one.against.scenes})
    title = f"{one.this.label} beside {one.against.label}"
    body = "".join(
        (
            f'<header><p class="kicker">Two datasets, the same statistics</p><h1>{escape(one.this.label)} '
            f"<small>beside</small> {escape(one.against.label)}</h1>"
            f'<p class="meaning">{escape(verdict(one))}</p></header>',
            _answers(one, units),
            "<h2>What differs most</h2>",
            _drawn(found, units),
            "<h2>All statistics</h2>",
            _table(one, units),
            _unmatched(one),
            '<div class="two"><section><h2>The two sides</h2>',
            pairs((_short(side), _side(side)) for side in (one.this, one.against)),
            "</section><section><h2>How this was measured</h2>",
            pairs(_manner(one)),
            "</section></div>",
        )
    )
    return document(title, "none", body, "", SEEING_STYLE)


def verdict(found: Comparison) -> str:
    """Return in one sentence how many statistics differ by more than luck."""
    if any(row.differs is None for row in found.rows):
        return (
            f"Too few episodes to tell a difference from luck ({found.this.compared} beside {found.against.compared}); "
            f"{len(found.rows)} statistics, by their distance."
        )
    count = sum(bool(row.differs) for row in found.rows)
    many = "No statistic differs" if not count else f"{count} of {len(found.rows)} statistics differ"
    return f"{many} by more than luck would make episodes of one world differ."


def row_unit(row: ComparisonRow, units: Mapping[str, str]) -> str:
    """Return the unit of a row as people read it."""
    return readable(row.unit, row.element, units)


def _answers(found: Comparison, units: Mapping[str, str]) -> str:
    """Return for each group what differs most in it."""
    cells = []
    for group, title in GROUPS.items():
        rows = [row for row in found.rows if row.group == group]
        count = sum(bool(row.differs) for row in rows)
        if not rows:
            lead, text = DASH, "Not on both sides."
        else:
            first = rows[0]
            lead = f"{count} of {len(rows)} differ"
            shown = f"{_value(first.this.median)} beside {_value(first.against.median)} {row_unit(first, units)}"
            text = f"Most: {first.statistic} {first.element}, median {shown.strip()}.".replace(" ,", ",")
        cells.append(f'<div><dt>{title}</dt><dd><span class="lead">{lead}</span>{escape(text)}</dd></div>')
    return f'<dl class="answers">{"".join(cells)}</dl>'


def _drawn(found: ComparisonResult, units: Mapping[str, str]) -> str:
    """Return the distributions of the first rows: those that differ, a few in any case."""
    count = max(6, sum(bool(row.differs) for row in found.comparison.rows))
    chosen = list(zip(found.comparison.rows, found.bars, strict=True))[: min(count, MOST_DRAWN)]
    cells = "".join(_cell(row, drawn, row_unit(row, units)) for row, drawn in chosen)
    names = [("this", found.comparison.this.label), ("against", found.comparison.against.label)]
    key = "".join(f'<span class="key-{kind}">{escape(name)}</span>' for kind, name in names)
    return f'<p class="sub key">{key}</p><div class="multiples wide">{cells}</div>'


def _cell(row: ComparisonRow, drawn: Bars, unit: str) -> str:
    """Return both distributions of a row under its name."""
    title = escape(f"{row.statistic} {row.element}".strip())
    words = f"{digits(row.spreads)} spreads apart" if row.spreads is not None else "always the same"
    words += ", beyond luck" if row.differs else ", within luck" if row.differs is False else ""
    if drawn.edges[0] == drawn.edges[-1]:
        inner = f'<p class="sub small">always {digits(float(drawn.edges[0]))} {escape(unit)}</p>'
    else:
        top = float(max(drawn.this.max(), drawn.against.max()))
        x, y = linear([drawn.edges[0], drawn.edges[-1]], 4), Axis(0, 1.06 * top, ((0.0, "0"), (top, percent(top))))
        sides = (("against", drawn.against), ("this", drawn.this))
        marks = "".join(bars(x, y, drawn.edges.tolist(), v.tolist(), f"histo {kind}") for kind, v in sides)
        inner = chart(x, y, marks, f"distributions of {row.statistic} {row.element}", 84, unit or "share", "share")
    return f'<div><p>{title}</p>{inner}<p class="sub small">{escape(words)}</p></div>'


def _table(found: Comparison, units: Mapping[str, str]) -> str:
    """Return all rows; those beyond luck stand out."""
    head = ("statistic", "of", "unit", found.this.label, found.against.label, "distance", "luck", "spreads", "")
    top = "".join(f"<th{_n(i)}>{escape(text)}</th>" for i, text in enumerate(head))
    longest = max((row.spreads or 0.0 for row in found.rows), default=0.0) or 1.0
    body = "".join(_row(row, units, longest) for row in found.rows[:MOST_ROWS])
    more = len(found.rows) - MOST_ROWS
    note = "Medians, and in brackets the middle 90 %." + (f" {more} more rows are in --json." if more > 0 else "")
    return (
        f'<p class="sub">{note}</p><div class="scroll" tabindex="0"><table class="rows"><thead><tr>{top}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _row(row: ComparisonRow, units: Mapping[str, str], longest: float) -> str:
    """Return one row of the table."""
    cells = (
        row.statistic, row.element or DASH, row_unit(row, units) or DASH, _spread(row.this), _spread(row.against),
        _value(row.distance), DASH if row.luck is None else _value(row.luck),
        DASH if row.spreads is None else digits(row.spreads),
    )  # fmt: skip
    inner = "".join(f"<td{_n(i)}>{escape(text)}</td>" for i, text in enumerate(cells))
    width = 100 * (row.spreads or 0.0) / longest
    kind = ' class="differs"' if row.differs else ""
    return f'<tr{kind}>{inner}<td class="weight"><i style="width:{width:.1f}%"></i></td></tr>'


def _n(column: int) -> str:
    """Return the class of a column that holds numbers."""
    return ' class="n"' if 3 <= column <= 7 else ""


def _spread(one: Spread) -> str:
    """Return `0.42 (0.1 to 0.9)`."""
    return f"{_value(one.median)} ({_value(one.low)} to {_value(one.high)})"


def _value(value: float) -> str:
    """Return a few digits."""
    return digits(value)


def _unmatched(found: Comparison) -> str:
    """Return what only one side has, and what else a reader must know; empty for nothing."""
    lines = [*found.unmatched, *found.notes]
    if not lines:
        return ""
    items = "".join(f"<li>{escape(text[0].upper() + text[1:])}.</li>" for text in lines)
    return f"<h2>What was not compared, and what to keep in mind</h2><ul>{items}</ul>"


def _short(side: Side) -> str:
    """Return `name@digest`."""
    return f"{side.label}@{side.digest[:12]}"


def _side(side: Side) -> str:
    """Return what was read of one side."""
    rates = ", ".join(f"{rate:g} Hz" for rate in side.rates_hz)
    sources = ", ".join(f"{name} {count}" for name, count in sorted(side.sources.items()))
    scenes = ", ".join(sorted(side.scenes)) or "no scene stated"
    return (
        f"{side.compared} of {side.episodes} episodes, {side.rows:,} rows, {digits(side.duration_s)} s at {rates}; "
        f"{sources}; {scenes}"
    )


def _manner(found: Comparison) -> list[tuple[str, str]]:
    """Return what the words of the table mean."""
    period = (
        f"By differences over {digits(1e3 * found.step_s)} ms on both sides, noise of the sensors included; of "
        "accelerations it may be most."
    )
    return [("speeds, accelerations", period), *_MANNER]
