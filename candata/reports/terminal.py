"""The summary that the command line prints: at most 25 lines."""

from __future__ import annotations

import textwrap

from candata.reports import advice, words
from candata.reports.numbers import percent, reading, unit_of
from candata.schema.report import NamedEffect, Report

#: Columns of the text, lines of the whole, and effects shown before the rest is counted.
WIDTH, MOST_LINES, MOST_EFFECTS = 98, 25, 3
#: Most lines of each entry; with two of the headline and one of space they are `MOST_LINES`.
LINES = {
    "where": 2, "which": 4, "how far": 3, "edit test": 2, "change": 3, "not known": 3, "untested": 1, "next": 2,
    "data": 2,
}  # fmt: skip


def summary(report: Report) -> str:
    """Return the verdict, where, which, how far, what to change, what is not known and what next as text."""
    headline = f"{report.verdict}: {words.explain(report.verdict)}"
    lines = [*textwrap.wrap(headline, WIDTH, max_lines=2, placeholder=" ..."), ""]
    lines += _entry("where", words.where(report), LINES["where"])
    lines += _which(report)
    lines += _entry("how far", words.how_far(report), LINES["how far"])
    lines += _entry("edit test", words.edit_test(report), LINES["edit test"])
    lines += _change(report)
    lines += _entry("not known", words.not_known(report), LINES["not known"])
    lines += _entry("untested", _untested(report), LINES["untested"])
    lines += _entry("next", words.next_motion(report), LINES["next"])
    lines += _entry("data", _data(report), LINES["data"])
    return "\n".join(lines)


def _which(report: Report) -> list[str]:
    """Return the effects, or the sentence that names none."""
    if not report.effects:
        return _entry("which", words.which(report), LINES["which"])
    return _several("which", [_effect(effect) for effect in report.effects], LINES["which"])


def _change(report: Report) -> list[str]:
    """Return what to change in the simulator."""
    texts = [str(one) for one in advice.changes(report)] or [advice.next_step(report)]
    return _several("change", texts, LINES["change"])


def _several(name: str, texts: list[str], most: int) -> list[str]:
    """Return a labelled list: two lines an item while there are few, else one; what has no room is counted."""
    shown = texts[:MOST_EFFECTS]
    each = max(1, most // len(shown)) if len(texts) > 1 else most
    lines: list[str] = []
    for text in shown:
        lines += _entry("" if lines else name, text, each)
    more = len(texts) - len(shown)
    return lines + (_entry("", f"and {more} more in report.json", 1) if more > 0 else [])


def _effect(effect: NamedEffect) -> str:
    """Return name, element, parameters with intervals and units, and share."""
    values = ", ".join(
        f"{name} {reading(estimate, unit_of(effect.name, name, estimate))}"
        for name, estimate in effect.parameters.items()
    )
    element = f" on {effect.element}" if effect.element else ""
    bound = ", at its bound" if effect.at_bound else ""
    return f"{effect.name}{element}: {values}{bound}; share {percent(effect.share)}"


def _untested(report: Report) -> str:
    """Return how much could not be tested; empty for nothing."""
    missing = [words.plain(c) for c in advice.missing_channels(report)]
    parts = [f"{words.listed(missing)} not recorded"] if missing else []
    silent = [words.plain(one.name) for one in report.ranking if one.reason == advice.SILENT]
    parts += [f"{len(silent)} effects move nothing in these motions: {words.listed(silent)}"] if silent else []
    return "; ".join(parts)


def _data(report: Report) -> str:
    """Return dataset, episodes, floor and notes on one line."""
    data, count = report.data, report.data.episodes
    floor = f", floor {data.floor}" if data.floor else ""
    notes = "".join(f"; {note}" for note in data.notes)
    return f"{data.dataset}, {count.total} episodes, {count.held_out} held out in {count.folds} folds{floor}{notes}"


def _entry(name: str, text: str, most: int) -> list[str]:
    """Return a labelled paragraph of at most `most` lines; nothing for an empty text."""
    if not text:
        return []
    indent = " " * 11
    lines = textwrap.wrap(
        words.tied(text),
        WIDTH,
        initial_indent=f"{name:<11}",
        subsequent_indent=indent,
        max_lines=most,
        placeholder=" ...",
        break_on_hyphens=False,
    )
    return [line.replace(words.TIE, " ") for line in lines]
