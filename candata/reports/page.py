"""The page of a diagnosis: four answers and what to change first, then the figures, then everything behind them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
from markupsafe import Markup

from candata.datasets.writing import write_text
from candata.gap.verdict.figures import Evidence, Example
from candata.reports import advice, exhibits, figures, heat, outcome, tables, words
from candata.reports.advice import ReportContext
from candata.reports.document import render_page
from candata.reports.filmstrip import filmstrip
from candata.reports.ghost import CLEARANCE_M
from candata.reports.numbers import percent
from candata.schema.report import Report

#: Colour of the headline for each verdict, a name in `templates/style.css.j2`.
TONES = {
    "no_gap": "good",
    "explained": "good",
    "partly_explained": "part",
    "ambiguous": "tie",
    "unknown_effect": "bad",
    "too_little_data": "none",
    "out_of_budget": "none",
}


#: Width at which an interval can still be seen on the bar [per cent of the bar].
LEAST_INTERVAL_PERCENT = 0.6


@dataclass(frozen=True)
class ClosedShareBar:
    """The share of the gap that closes, as text and as a bar; its interval, where it is known, as (left, width).

    Lengths are in per cent of the bar.
    """

    text: str
    fill: float
    interval: tuple[float, float] | None


@dataclass(frozen=True)
class ReportAnswer:
    """A question with its answer: a few large words, which may be empty, a bar or None, and a sentence."""

    question: str
    lead: str
    bar: ClosedShareBar | None
    sentence: str


def write_report(
    report: Report,
    evidence: Evidence,
    model: mujoco.MjModel | None,
    out: Path,
    effects_yaml: str,
    context: ReportContext | None = None,
) -> Path:
    """Write `report.html` into the folder `out` and return its path.

    Parameters
    ----------
    report : Report
        The diagnosis.
    evidence : Evidence
        What the figures draw; a part that is None is left out.
    model : mujoco.MjModel or None
        The nominal model for the filmstrip; None leaves the filmstrip out.
    out : Path
        Folder, made when missing.
    effects_yaml : str
        Text of `effects.yaml`, shown with a button that copies it.
    context : ReportContext, optional
        What advice needs beside the record; by default nothing is known. Its folder is not looked at: a page names
        the files beside it, so it is the same wherever it lies.
    """
    return write_text(Path(out) / "report.html", page(report, evidence, model, effects_yaml, context), "report")


def page(
    report: Report,
    evidence: Evidence,
    model: mujoco.MjModel | None,
    effects_yaml: str,
    context: ReportContext | None = None,
) -> str:
    """Return the whole page as text."""
    context = (context or ReportContext()).beside_files()
    headline = outcome.headline(report)
    return render_page(
        "diagnosis",
        title=f"{headline}: {report.data.dataset}",
        tone=TONES[report.verdict],
        headline=headline,
        report=report,
        outcome=outcome.outcome(report),
        notes=" ".join(
            filter(
                None,
                (outcome.belief_note(report), outcome.FLOOR if report.gap else "", outcome.against_note(report)),
            )
        ),
        answers=_answers(report, context),
        changes=advice.changes(report, context),
        mjcf_lines=context.mjcf_lines,
        commands=advice.commands(report, context),
        no_attribute=advice.NO_ATTRIBUTE,
        next_step=advice.next_step(report),
        repair=words.after_name(report),
        figures=_figures(report, evidence),
        significant_p=heat.SIGNIFICANT_P,
        alike_cosine=heat.ALIKE_COSINE,
        panel_key=_panel_key(report, evidence),
        filmstrip=filmstrip(model, evidence.example, words.after_name(report)) if evidence.example else "",
        clearance_mm=f"{1000 * CLEARANCE_M:g}",
        example=evidence.example,
        traces=_traces(evidence.example) if evidence.example else [],
        named_effects=tables.effect_rows(report, evidence.ranges),
        ranges_known=bool(evidence.ranges),
        unknown=tables.unknown_rows(report.unknown) if report.unknown else [],
        next_motion=tables.motion_rows(report.next_motion) if report.next_motion else [],
        further_fields=tables.further_rows(report),
        measure_columns=tables.measure_columns(report),
        measures=tables.measure_rows(report),
        untested=tables.untested_rows(report),
        data=tables.data_rows(report),
        verdicts=tables.verdict_rows(),
        terms=outcome.TERMS,
        effects_yaml=effects_yaml.strip(),
    )


def _answers(report: Report, context: ReportContext) -> list[ReportAnswer]:
    """Return where the gap is, which effect makes it, how far it closes, and what is not known."""
    sentences = (
        words.closure_sentence(report),
        words.calibration_sentence(report),
        words.edit_sentence(report),
        words.learned_sentence(report),
    )
    closure = " ".join(filter(None, sentences))
    unknowns = " ".join(filter(None, (words.unknowns_sentence(report), advice.next_motion(report, context))))
    return [
        ReportAnswer("Where is the gap?", words.where_headline(report), None, words.where_sentence(report)),
        ReportAnswer("Which effect makes it?", words.cause_headline(report), None, words.cause_sentence(report)),
        ReportAnswer("How far does it close?", "", _closed_share_bar(report), closure),
        ReportAnswer("What is not known?", "", None, unknowns),
    ]


def _closed_share_bar(report: Report) -> ClosedShareBar | None:
    """Return the share closed with its interval; None when it was not measured."""
    gap = report.gap
    if gap is None or gap.closed is None or not words.repair_was_tried(report):
        return None
    interval = None
    if gap.low is not None and gap.high is not None:
        low, high = _bar_percent(gap.low), _bar_percent(gap.high)
        interval = (low, max(high - low, LEAST_INTERVAL_PERCENT))
    return ClosedShareBar(percent(gap.closed), _bar_percent(gap.closed), interval)


def _figures(report: Report, evidence: Evidence) -> dict[str, Markup]:
    """Return the figures by name; one without evidence is empty."""
    has_candidates = any(not candidate.reason for candidate in report.ranking)
    return {
        "heat_map": _heat_map(evidence),
        "panels": _panels(report, evidence),
        "candidates": figures.candidates(report) if has_candidates else Markup(""),
        "before_after": _before_after(report, evidence),
        "collinearity": heat.collinearity(evidence.collinearity) if evidence.collinearity else Markup(""),
    }


def _heat_map(evidence: Evidence) -> Markup:
    """Return the heat map, its rows to be clicked where the elements' episodes are known; empty without one."""
    if evidence.heat is None or not len(evidence.heat.rows):
        return Markup("")
    labels = [element.label for element in evidence.elements.of] if evidence.elements else []
    return heat.heat_map(evidence.heat, frozenset(labels))


def _panels(report: Report, evidence: Evidence) -> Markup:
    """Return the episodes of each element, those of the strongest symptom in sight; empty without a heat map."""
    elements = evidence.elements
    if evidence.heat is None or not len(evidence.heat.rows) or elements is None or not elements.of:
        return Markup("")
    label = exhibits.most_telling_label(elements, report, evidence.heat)
    return exhibits.panels(elements, label, words.after_name(report))


def _panel_key(report: Report, evidence: Evidence) -> list[tuple[str, str]]:
    """Return class and name of each kind of mark in the panels."""
    entries = [("recorded", "recorded"), ("nominal", "nominal")]
    if evidence.elements and any(element.after is not None for element in evidence.elements.of):
        entries.append(("repaired", words.after_name(report)))
    return [*entries, ("noise", "noise alone")]


def _before_after(report: Report, evidence: Evidence) -> Markup:
    """Return the mean mismatch as bars and, where they are known, that of every episode."""
    if report.gap is None:
        return Markup("")
    repair = words.after_name(report) if words.repair_was_tried(report) else None
    figure = figures.mismatch_bars(report.gap, repair)
    if evidence.losses is not None and len(evidence.losses.ids):
        figure += figures.losses(evidence.losses, repair)
    return figure


def _traces(example: Example) -> list[tuple[str, str, Markup]]:
    """Return name, unit and chart of each trace of the example."""
    return [
        (
            f"{words.readable_name(trace.channel)} {trace.element}".strip(),
            trace.unit,
            figures.trace(example.time_s, trace),
        )
        for trace in example.traces
    ]


def _bar_percent(share: float) -> float:
    """Return a share as a percentage between 0 and 100."""
    return 100 * min(max(share, 0.0), 1.0)
