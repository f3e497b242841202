"""The summary that the command line prints: at most 25 lines."""

from __future__ import annotations

import textwrap

from candata.reports import advice, words
from candata.reports.numbers import format_estimate, percent, unit_of
from candata.schema.report import NamedEffect, Report

#: Columns of the text, and effects shown before the rest is counted.
WIDTH, MOST_EFFECTS = 98, 3
#: Most lines of each entry.
LINES = {
    "where": 2,
    "which": 4,
    "how far": 3,
    "calibrated": 2,
    "edit test": 2,
    "model": 2,
    "change": 3,
    "not known": 3,
    "untested": 1,
    "next": 2,
    "data": 2,
}
#: Columns of the entries' names.
LABEL_WIDTH = 11


def summary(report: Report) -> str:
    """Return the diagnosis as text: where, which, how far, what to change, what is not known, what is next."""
    headline = f"{report.verdict}: {words.meaning(report)}"
    lines = [*textwrap.wrap(headline, WIDTH, max_lines=2, placeholder=" ..."), ""]
    lines += _entry("where", words.where_sentence(report), LINES["where"])
    lines += _causes(report)
    lines += _entry("how far", words.closure_sentence(report), LINES["how far"])
    lines += _entry("calibrated", words.calibration_sentence(report), LINES["calibrated"])
    lines += _entry("edit test", words.edit_sentence(report), LINES["edit test"])
    lines += _entry("model", words.learned_sentence(report), LINES["model"])
    lines += _changes(report)
    lines += _entry("not known", words.unknowns_sentence(report), LINES["not known"])
    lines += _entry("untested", _untested_words(report), LINES["untested"])
    lines += _entry("next", words.next_motion_sentence(report), LINES["next"])
    lines += _entry("data", _data(report), LINES["data"])
    return "\n".join(lines)


def _causes(report: Report) -> list[str]:
    """Return the effects, or the sentence that names none."""
    if not report.effects:
        return _entry("which", words.cause_sentence(report), LINES["which"])
    return _list_entry("which", [_effect(effect) for effect in report.effects], LINES["which"])


def _changes(report: Report) -> list[str]:
    """Return what to change in the simulator."""
    texts = [str(change) for change in advice.changes(report)] or [advice.next_step(report)]
    return _list_entry("change", texts, LINES["change"])


def _list_entry(name: str, texts: list[str], most_lines: int) -> list[str]:
    """Return a labelled list: two lines an item while there are few, else one; what has no room is counted."""
    items = texts[:MOST_EFFECTS]
    lines_per_item = max(1, most_lines // len(items)) if len(texts) > 1 else most_lines
    lines: list[str] = []
    for text in items:
        lines += _entry("" if lines else name, text, lines_per_item)
    omitted_count = len(texts) - len(items)
    return lines + (_entry("", f"and {omitted_count} more in report.json", 1) if omitted_count > 0 else [])


def _effect(effect: NamedEffect) -> str:
    """Return name, element, parameters with intervals and units, and share."""
    values = ", ".join(
        f"{name} {format_estimate(estimate, unit_of(effect.name, name, estimate))}"
        for name, estimate in effect.parameters.items()
    )
    element = f" on {effect.element}" if effect.element else ""
    bound_note = ", at its bound" if effect.at_bound else ""
    return f"{effect.name}{element}: {values}{bound_note}; share {percent(effect.share)}"


def _untested_words(report: Report) -> str:
    """Return how much could not be tested; empty for nothing."""
    channels = [words.readable_name(channel) for channel in advice.missing_channels(report)]
    parts = [f"{words.enumeration(channels)} not recorded"] if channels else []
    effects = [words.readable_name(c.name) for c in report.ranking if c.reason == advice.NO_RESPONSE]
    if effects:
        parts.append(f"{len(effects)} effects move nothing in these motions: {words.enumeration(effects)}")
    return "; ".join(parts)


def _data(report: Report) -> str:
    """Return dataset, episodes, floor and notes on one line."""
    data, count = report.data, report.data.episodes
    floor = f", floor {data.floor}" if data.floor else ""
    notes = "".join(f"; {note}" for note in data.notes)
    return f"{data.dataset}, {count.total} episodes, {count.held_out} held out in {count.folds} folds{floor}{notes}"


def _entry(name: str, text: str, most_lines: int) -> list[str]:
    """Return a labelled paragraph of at most `most_lines` lines; nothing for an empty text."""
    if not text:
        return []
    lines = textwrap.wrap(
        words.keep_units(text),
        WIDTH,
        initial_indent=f"{name:<{LABEL_WIDTH}}",
        subsequent_indent=" " * LABEL_WIDTH,
        max_lines=most_lines,
        placeholder=" ...",
        break_on_hyphens=False,
    )
    return [line.replace(words.TIE, " ") for line in lines]
