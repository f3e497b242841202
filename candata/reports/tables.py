"""The rows of the tables on the page of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

from markupsafe import Markup

from candata.gap.verdict.figures import Range
from candata.reports import advice, figures, words
from candata.reports.numbers import digits, format_estimate, percent, unit_of
from candata.reports.outcome import explain
from candata.schema.record import Record
from candata.schema.report import Estimate, NextMotion, Report, UnknownCause, Verdict

#: Fields of a report that the page shows in parts of their own.
SHOWN_FIELDS = frozenset(
    [
        "verdict",
        "effects",
        "ambiguous_class",
        "unknown",
        "ranking",
        "gap",
        "where",
        "next_motion",
        "data",
        "measures",
        "provenance",
    ]
)
#: The floor's origin in words.
FLOORS = {
    "measured": "measured from repeated episodes",
    "declared": "declared in the scene",
    "assumed": "assumed from quiet stretches",
}


@dataclass(frozen=True)
class NamedEffectRow:
    """One parameter of a named effect: its estimate, and the range in which it was searched, as text and drawn."""

    effect: str
    parameter: str
    value: str
    interval: str
    range_text: str
    at_bound: bool
    range_drawing: Markup
    share: float
    support: float


def effect_rows(report: Report, ranges: Mapping[tuple[str, str | None, str], Range]) -> list[NamedEffectRow]:
    """Return a row for each parameter of each named effect."""
    rows = []
    for effect in report.effects:
        for name, estimate in effect.parameters.items():
            unit = unit_of(effect.name, name, estimate)
            text, search_range = format_estimate(estimate, unit), ranges.get((effect.name, effect.element, name))
            rows.append(
                NamedEffectRow(
                    effect=words.effect_title(effect.name, effect.element),
                    parameter=f"{name} [{text.unit}]" if text.unit else name,
                    value=text.value,
                    interval=text.interval or "not given",
                    range_text=_range_text(search_range, unit) if search_range else "",
                    at_bound=effect.at_bound,
                    range_drawing=figures.parameter_range(estimate, search_range),
                    share=effect.share,
                    support=effect.support,
                )
            )
    return rows


def _range_text(search_range: Range, unit: str) -> str:
    """Return `0 to 0.3 N m`."""
    text = format_estimate(Estimate(value=(search_range.low, search_range.high)), unit)
    return f"{' to '.join(text.value.strip('[]').split(', '))} {text.unit}".strip()


def unknown_rows(part: UnknownCause) -> list[tuple[str, str]]:
    """Return what is known of the part that no effect explains: where it acts, its size, what it depends on."""
    size = f"{digits(part.size)} {part.unit or ''}".strip() if part.size is not None else ""
    return [
        ("in words", part.words),
        ("acts on", " ".join(filter(None, (part.acts_on, part.element)))),
        ("size", size),
        ("depends on", ", ".join(part.depends_on)),
        ("closable by a fitted force", percent(part.closable) if part.closable is not None else ""),
        *_other_fields(part, {"words", "acts_on", "element", "size", "unit", "depends_on", "closable"}),
    ]


def motion_rows(motion: NextMotion) -> list[tuple[str, str]]:
    """Return what to record next: the motion, its file, what it separates."""
    return [
        ("motion", words.readable_name(motion.name)),
        ("command file", motion.file or ""),
        ("separates", words.enumeration([words.label_title(label) for label in motion.separates], "from")),
        ("how", "play it on the real hand, append the recording to the dataset, and diagnose again"),
        *_other_fields(motion, {"name", "file", "separates"}),
    ]


def further_rows(report: Report) -> list[tuple[str, str]]:
    """Return what newer versions of the record hold beyond what this page knows."""
    return _other_fields(report, SHOWN_FIELDS)


def untested_rows(report: Report) -> list[tuple[str, str]]:
    """Return what could not be tested and why: channels, effects that nothing shows, effects that cannot act."""
    rows = [(words.readable_name(c), "not recorded, so it was not compared") for c in advice.missing_channels(report)]
    return rows + [(words.sentence_case(effects), reason) for effects, reason in advice.untested_effects(report)]


def _other_fields(record: Record, shown_fields: frozenset[str] | set[str]) -> list[tuple[str, str]]:
    """Return the fields of a record that are not shown elsewhere, nested ones with their own names."""
    rows = []
    for name in type(record).model_fields:
        value = getattr(record, name)
        if name in shown_fields or value in (None, (), "", {}):
            continue
        plain_value = value.model_dump(mode="json") if isinstance(value, Record) else value
        text = str(plain_value)
        if isinstance(plain_value, dict):
            text = ", ".join(f"{words.readable_name(key)} {entry}" for key, entry in plain_value.items())
        rows.append((words.readable_name(name), text))
    return rows


def measure_columns(report: Report) -> list[str]:
    """Return the columns of the plain measures."""
    return list(dict.fromkeys(key for row in report.measures.values() for key in row))


def measure_rows(report: Report) -> list[tuple[str, ...]]:
    """Return the plain measures, one a row."""
    columns = measure_columns(report)
    return [
        (words.readable_name(name), *(_measured(row[column]) if column in row else "" for column in columns))
        for name, row in report.measures.items()
    ]


def _measured(value: float | None) -> str:
    """Return a measure, or a question mark where nothing could be measured."""
    return "?" if value is None else digits(value)


def verdict_rows() -> list[tuple[str, str]]:
    """Return each verdict word with its meaning."""
    return [(word, explain(word)) for word in get_args(Verdict)]


def data_rows(report: Report) -> list[tuple[str, str]]:
    """Return what the diagnosis saw and where it came from."""
    source, count = report.data, report.data.episodes
    held_out = "each held out once" if count.held_out == count.total else f"of which {count.held_out} held out"
    rows = [
        ("dataset", source.dataset),
        ("episodes", f"{count.total}, {held_out} in {count.folds} folds"),
        ("floor", FLOORS.get(source.floor or "", "none")),
        ("channels", ", ".join(source.channels)),
        *(("note", note) for note in source.notes),
        *report.provenance.items(),
    ]
    return [(words.readable_name(name), text) for name, text in rows]
