"""The summary that the command line prints: whole sentences, at most 80 columns wide."""

from __future__ import annotations

import textwrap

from candata.reports import advice, words
from candata.reports.advice import ReportContext
from candata.reports.numbers import format_estimate, percent, unit_of
from candata.reports.outcome import against_note, belief_note, outcome
from candata.schema.report import NamedEffect, Report

#: Columns of the text: those of a terminal as it opens.
WIDTH = 80
#: Columns of the entries' names.
LABEL_WIDTH = 11
#: What a floor is, in the words of a terminal.
FLOOR = "1 floor is the mismatch that sensor noise alone makes"


def summary(report: Report, context: ReportContext | None = None) -> str:
    """Return the diagnosis as text: what happened, where, which, how far, what to change, what is not known.

    Parameters
    ----------
    report : Report
    context : ReportContext, optional
        Where the report lies and what the scene's groups hold, for commands that run as they are printed.
    """
    context = context or ReportContext()
    floor = f"({FLOOR}.)" if report.gap is not None else ""
    notes = (f"{report.verdict}: {outcome(report)}", belief_note(report), floor, against_note(report))
    first_sentences = " ".join(filter(None, notes))
    lines = [*textwrap.wrap(words.keep_units(first_sentences), WIDTH, break_on_hyphens=False), ""]
    lines += _entry("where", words.where_sentence(report))
    lines += _list_entry("which", [_effect(e) for e in report.effects] or [words.cause_sentence(report)])
    lines += _entry("how far", words.closure_sentence(report))
    lines += _entry("calibrated", words.calibration_sentence(report))
    lines += _entry("edit test", words.edit_sentence(report))
    lines += _entry("model", words.learned_sentence(report))
    lines += _list_entry(
        "change", [str(change) for change in advice.changes(report, context)] or [advice.next_step(report)]
    )
    lines += _entry("not known", words.unknowns_sentence(report))
    lines += _entry("untested", _untested_words(report))
    lines += _entry("next", advice.next_motion(report, context))
    lines += _entry("data", _data(report))
    text = "\n".join(line.replace(words.TIE, " ") for line in lines)
    return "\n".join([text, *_commands(report, context)])


def _commands(report: Report, context: ReportContext) -> list[str]:
    """Return the commands that use the repair, each on a line of its own, never broken."""
    lines = []
    for purpose, command in advice.commands(report, context):
        lines += ["", f"To {purpose}:", f"  {command}"]
    return lines


def _list_entry(name: str, texts: list[str]) -> list[str]:
    """Return a labelled list, each item on lines of its own."""
    lines: list[str] = []
    for text in texts:
        lines += _entry("" if lines else name, text)
    return lines


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
    """Return how much could not be tested; empty for nothing. The page lists the effects."""
    channels = [words.readable_name(channel) for channel in advice.missing_channels(report)]
    parts = [f"{words.enumeration(channels)} not recorded"] if channels else []
    count = sum(candidate.reason == advice.NO_RESPONSE for candidate in report.ranking)
    if count:
        subject = "1 effect moves" if count == 1 else f"{count} effects move"
        parts.append(f"{subject} nothing in these motions (see report.html)")
    return "; ".join(parts)


def _data(report: Report) -> str:
    """Return dataset, episodes, floor and notes."""
    data, count = report.data, report.data.episodes
    floor = f", floor {data.floor}" if data.floor else ""
    notes = "".join(f"; {note}" for note in data.notes)
    return f"{data.dataset}, {count.total} episodes, {count.held_out} held out in {count.folds} folds{floor}{notes}"


def _entry(name: str, text: str) -> list[str]:
    """Return a labelled paragraph; nothing for an empty text."""
    if not text:
        return []
    return textwrap.wrap(
        words.keep_units(text),
        WIDTH,
        initial_indent=f"{name:<{LABEL_WIDTH}}",
        subsequent_indent=" " * LABEL_WIDTH,
        break_on_hyphens=False,
        break_long_words=False,
    )
