"""The summary that the command line prints: at most 25 lines."""

from __future__ import annotations

import textwrap

from candata.reports import words
from candata.reports.numbers import percent, reading, unit_of
from candata.schema.report import NamedEffect, Report

#: Columns of the text, lines of the whole, and effects shown before the rest is counted.
WIDTH, MOST_LINES, MOST_EFFECTS = 98, 25, 4


def summary(report: Report) -> str:
    """Return the verdict, where, which, how far, what is not known and the next motion as text."""
    headline = f"{report.verdict}: {words.explain(report.verdict)}"
    lines = [*textwrap.wrap(headline, WIDTH, max_lines=2, placeholder=" ..."), ""]
    lines += _entry("where", words.where(report), 3)
    lines += _which(report)
    lines += _entry("how far", words.how_far(report), 3)
    lines += _entry("not known", words.not_known(report), 4)
    lines += _entry("next", words.next_motion(report), 3)
    lines += _entry("data", _data(report), 2)
    return "\n".join(lines[:MOST_LINES])


def _which(report: Report) -> list[str]:
    """Return the effects with one parameter a line, or the sentence that names none."""
    if not report.effects:
        return _entry("which", words.which(report), 3)
    lines: list[str] = []
    for effect in report.effects[:MOST_EFFECTS]:
        lines += _entry("" if lines else "which", _effect(effect), 2)
    more = len(report.effects) - MOST_EFFECTS
    return lines + (_entry("", f"and {more} more in report.json", 1) if more > 0 else [])


def _effect(effect: NamedEffect) -> str:
    """Return name, element, parameters with intervals and units, and share."""
    values = ", ".join(
        f"{name} {reading(estimate, unit_of(effect.name, name))}" for name, estimate in effect.parameters.items()
    )
    element = f" on {effect.element}" if effect.element else ""
    bound = ", at its bound" if effect.at_bound else ""
    return f"{effect.name}{element}: {values}{bound}; share {percent(effect.share)}"


def _data(report: Report) -> str:
    """Return dataset, episodes and floor on one line."""
    data, count = report.data, report.data.episodes
    floor = f", floor {data.floor}" if data.floor else ""
    return f"{data.dataset}, {count.total} episodes, {count.held_out} held out in {count.folds} folds{floor}"


def _entry(name: str, text: str, most: int) -> list[str]:
    """Return a labelled paragraph of at most `most` lines; nothing for an empty text."""
    if not text:
        return []
    indent = " " * 11
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=f"{name:<11}",
        subsequent_indent=indent,
        max_lines=most,
        placeholder=" ...",
        break_on_hyphens=False,
    )
