"""The self-contained page: four answers and what to change first, then the figures, then everything behind them.

Plotly, which draws the pages of evaluations, is not used here: it is 5 MB that every copy of a report would carry, its
figures are empty without a script, and it knows nothing of the page's theme. These figures are few and plain, so they
are drawn as SVG and tables when the page is written; the script only shows the element that is clicked.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

import mujoco

from candata.datasets.writing import write_text
from candata.gap.evidence import Evidence, Example
from candata.reports import advice, exhibits, figures, heat, tables, words
from candata.reports.document import document, figure
from candata.reports.filmstrip import filmstrip
from candata.reports.numbers import percent
from candata.schema.report import Report

#: Colour of the headline for each verdict.
TONES = {
    "no_gap": "good",
    "explained": "good",
    "partly_explained": "part",
    "ambiguous": "tie",
    "unknown_effect": "bad",
    "too_little_data": "none",
    "out_of_budget": "none",
}


def write_report(
    report: Report, evidence: Evidence, model: mujoco.MjModel | None, out: Path, effects_yaml: str
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
    """
    return write_text(Path(out) / "report.html", page(report, evidence, model, effects_yaml), "report")


def page(report: Report, evidence: Evidence, model: mujoco.MjModel | None, effects_yaml: str) -> str:
    """Return the whole page as text."""
    body = "".join(
        (
            _head(report),
            _answers(report),
            _change(report),
            _where(report, evidence),
            _which(report, evidence),
            _strip(report, evidence.example, model),
            tables.effects(report, evidence.ranges),
            tables.unknown(report),
            tables.next_motion(report),
            tables.further(report),
            tables.measures(report),
            tables.untested(report),
            _file(report, effects_yaml),
            '<div class="two"><section><h2>Data and provenance</h2>',
            f"{tables.data(report)}</section><section><h2>What the words mean</h2>",
            f"{tables.verdicts(report)}</section></div>",
        )
    )
    return document(f"{words.HEADLINES[report.verdict]}: {report.data.dataset}", TONES[report.verdict], body)


def _head(report: Report) -> str:
    """Return the verdict, large, and what it means."""
    return (
        f'<header><p class="kicker">Sim-to-real gap of {escape(report.data.dataset)}</p>'
        f"<h1>{escape(words.HEADLINES[report.verdict])}</h1>"
        f'<p class="meaning">{escape(words.explain(report.verdict))}</p></header>'
    )


def _answers(report: Report) -> str:
    """Return where, which, how far and what is not known, one sentence each."""
    unknown = " ".join(filter(None, (words.not_known(report), words.next_motion(report))))
    far = " ".join(filter(None, (words.how_far(report), words.edit_test(report))))
    entries = (
        ("Where is the gap?", _lead(words.where_short(report)) + typeset(words.where(report))),
        ("Which effect makes it?", _lead(words.which_short(report)) + typeset(words.which(report))),
        ("How far does it close?", _meter(report) + typeset(far)),
        ("What is not known?", typeset(unknown)),
    )
    return f'<dl class="answers">{"".join(f"<div><dt>{q}</dt><dd>{a}</dd></div>" for q, a in entries)}</dl>'


def _change(report: Report) -> str:
    """Return what to change in the simulator, or why nothing yet."""
    found = advice.changes(report)
    if not found:
        inner = f"<p>{typeset(advice.next_step(report))}</p>"
    else:
        items = "".join(f"<li>{typeset(one.what)}.<small>{_mjcf(one.mjcf)}</small></li>" for one in found)
        both = "All of it at once: <code>candata generate-sim --effects effects.yaml --episodes 8 --out repaired</code>"
        inner = f'<ul>{items}</ul><p class="note">{both}</p>'
    return f'<section class="change"><h3>What to change in your simulator</h3>{inner}</section>'


def _mjcf(text: str) -> str:
    """Return how MJCF says a change, or that it cannot."""
    return f"In MJCF: {escape(text)}" if text else escape(advice.NO_ATTRIBUTE)


def typeset(text: str) -> str:
    """Return a sentence as HTML in which no line ends between a number and its unit."""
    return escape(words.tied(text))


def _lead(text: str) -> str:
    """Return the few words that stand large above a sentence; empty for none."""
    return f'<span class="lead">{escape(text)}</span>' if text else ""


def _meter(report: Report) -> str:
    """Return the share closed as a large number with its interval on a bar; empty when not measured."""
    gap = report.gap
    if gap is None or gap.closed is None or not words.was_tried(report):
        return ""
    fill = _clipped(gap.closed)
    span = ""
    if gap.low is not None and gap.high is not None:
        low, high = _clipped(gap.low), _clipped(gap.high)
        span = f'<b style="left:{low:.1f}%;width:{max(high - low, 0.6):.1f}%"></b>'
    return (
        f'<span class="lead big">{percent(gap.closed)}</span>'
        f'<span class="bar" aria-hidden="true"><i style="width:{fill:.1f}%"></i>{span}</span>'
    )


def _where(report: Report, evidence: Evidence) -> str:
    """Return the heat map beside the episodes of the element chosen in it."""
    if evidence.heat is None or not len(evidence.heat.rows):
        return ""
    shown = evidence.elements
    labels = frozenset(one.label for one in shown.of) if shown else frozenset()
    sub = "Mismatch over its floor (what noise alone gives); numbers where chance is ruled out (p at most 0.05)."
    sub += " Click a row to see its episodes." if labels else ""
    drawn = figure("Where: channel by phase", sub, heat.heat_map(evidence.heat, labels))
    if shown is None or not shown.of:
        return f'<div class="look">{drawn}</div>'
    name = words.after_name(report)
    names = [("recorded", "recorded"), ("nominal", "nominal"), ("noise", "noise alone")]
    names[2:2] = [("repaired", name)] if _repaired(evidence) else []
    first = exhibits.first_shown(shown, report, evidence.heat)
    right = f'<figure class="shown">{exhibits.panels(shown, first, name)}{_key_of(names)}</figure>'
    return f'<div class="look">{drawn}{right}</div>'


def _repaired(evidence: Evidence) -> bool:
    """Tell whether the elements were simulated with a repair."""
    return evidence.elements is not None and any(one.after is not None for one in evidence.elements.of)


def _which(report: Report, evidence: Evidence) -> str:
    """Return the ranking, before and after with every episode, and the collinearity of the candidates."""
    parts = []
    if any(not c.reason for c in report.ranking):
        more = sum(not c.reason for c in report.ranking) - len(figures.shown_candidates(report))
        note = f'<p class="note">{more} more in report.json.</p>' if more > 0 else ""
        sub = (
            "Each effect alone: gain over the unchanged simulation on held-out episodes [floors], 90 % interval."
            " Support: how often it comes first when episodes are resampled."
        )
        parts.append(figure("Which: the candidates", sub, figures.ranking(report) + note))
    if report.gap is not None:
        tried = words.was_tried(report)
        inner = figures.how_far(report.gap, words.after_name(report) if tried else None)
        if evidence.losses is not None and len(evidence.losses.ids):
            inner += figures.losses(evidence.losses, words.after_name(report), tried)
        sub = "Mean mismatch on held-out episodes; below, every episode: the band is what noise alone gives."
        parts.append(figure("How far: before, after, floor", sub, inner))
    if evidence.collinearity is not None:
        sub = (
            "Cosine between what two candidates change in the readings; 1: alike up to their size. Bold from 0.65 on: "
            "hard to tell apart with these motions."
        )
        parts.append(figure("Which candidates look alike", sub, heat.collinearity(evidence.collinearity)))
    return f'<div class="first">{"".join(parts)}</div>' if parts else ""


def _strip(report: Report, example: Example | None, model: mujoco.MjModel | None) -> str:
    """Return the filmstrip and the traces of one held-out episode."""
    if example is None:
        return ""
    pictures = filmstrip(model, example, words.after_name(report))
    traces = _traces(report, example)
    if not pictures and not traces:
        return ""
    sub = f"Episode {example.episode}: the recording beside the simulation of the same commands."
    title = "Real, nominal, repaired" if example.qpos_after is not None else "Real and nominal"
    return f'<div class="strip">{figure(title, sub, pictures + traces)}</div>'


def _traces(report: Report, example: Example) -> str:
    """Return the traces of the example as small multiples, with their key."""
    cells = []
    for one in example.traces:
        label = f"{words.plain(one.channel)} {one.element}".strip()
        unit = f" <small>[{escape(one.unit)}]</small>" if one.unit else ""
        cells.append(f"<div><p>{escape(label)}{unit}</p>{figures.trace(example.time_s, one)}</div>")
    if not cells:
        return ""
    names = [("recorded", "recorded"), ("nominal", "nominal")]
    if any(one.after is not None for one in example.traces):
        names.append(("repaired", words.after_name(report)))
    return f'{_key_of(names)}<div class="traces">{"".join(cells)}</div>'


def _file(report: Report, effects_yaml: str) -> str:
    """Return `effects.yaml` with a copy button; nothing where nothing is repaired."""
    if not report.effects:
        return ""
    return (
        "<h2>The repaired simulator: effects.yaml</h2>"
        '<div class="file"><button id="copy" type="button">Copy</button>'
        f'<pre id="effects-file" tabindex="0">{escape(effects_yaml.strip())}\n</pre></div>'
    )


def _key_of(names: list[tuple[str, str]]) -> str:
    """Return the key of lines: (class, name)."""
    spans = "".join(f'<span class="{kind}">{escape(name)}</span>' for kind, name in names)
    return f'<p class="sub key">{spans}</p>'


def _clipped(share: float) -> float:
    """Return a share as a percentage between 0 and 100."""
    return 100 * min(max(share, 0.0), 1.0)
