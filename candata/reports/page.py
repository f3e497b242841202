"""The self-contained page: three answers and three figures first, then everything behind them."""

from __future__ import annotations

import re
from html import escape
from pathlib import Path

import mujoco

from candata.gap.evidence import Evidence, Example
from candata.reports import figures, tables, words
from candata.reports.document import document, figure, plot
from candata.reports.figures import Spec
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
}
#: Traces on the first screen; further ones stand below the filmstrip.
FIRST_TRACES = 3


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
    path = Path(out) / "report.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(report, evidence, model, effects_yaml), encoding="utf-8")
    return path


def page(report: Report, evidence: Evidence, model: mujoco.MjModel | None, effects_yaml: str) -> str:
    """Return the whole page as text."""
    specs: dict[str, Spec] = {}
    body = "".join(
        (
            _head(report),
            _answers(report),
            _first_screen(report, evidence, specs),
            _strip(report, evidence.example, model, specs),
            f"<h2>Named effects</h2>{tables.effects(report)}",
            tables.unknown(report),
            tables.measures(report),
            _episodes(report, evidence, specs),
            _file(effects_yaml),
            '<div class="two"><section><h2>Data and provenance</h2>',
            f"{tables.data(report)}</section><section><h2>What the verdict words mean</h2>",
            f"{tables.verdicts(report)}</section></div>",
        )
    )
    title = f"{words.HEADLINES[report.verdict]}: {report.data.dataset}"
    return document(title, TONES[report.verdict], body, specs)


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


def typeset(text: str) -> str:
    """Return a sentence as HTML in which no line ends between a number and its unit."""
    tied = re.sub(r"(?<=\d) (?=(?:%|N|m|mm|ms|s|mrad|rad|kg|g|ppm)(?:\W|$))", "\N{NO-BREAK SPACE}", escape(text))
    return tied.replace("p = ", "p\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}").replace(
        " m s/rad", "\N{NO-BREAK SPACE}m\N{NO-BREAK SPACE}s/rad"
    )


def _lead(text: str) -> str:
    """Return the few words that stand large above a sentence; empty for none."""
    return f'<span class="lead">{escape(text)}</span>' if text else ""


def _meter(report: Report) -> str:
    """Return the share closed as a large number with its interval on a bar; empty when not measured."""
    gap = report.gap
    if gap is None or gap.closed is None:
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


def _first_screen(report: Report, evidence: Evidence, specs: dict[str, Spec]) -> str:
    """Return the heat map, the ranking and the first traces; adds their specifications."""
    parts = []
    if evidence.heat is not None and len(evidence.heat.rows):
        specs["heat"] = figures.heat_map(evidence.heat)
        parts.append(
            figure(
                "Where",
                "mismatch over its floor (what noise alone gives); numbers where p is at most 0.05",
                plot("heat", specs),
            )
        )
    if report.ranking:
        specs["ranking"] = figures.ranking(report)
        hidden = len(report.ranking) - len(figures.shown_candidates(report))
        more = f'<p class="note">{hidden} more in report.json.</p>' if hidden else ""
        sub = "gain over the unchanged simulation on held-out episodes, 90 % interval; named effects in colour"
        parts.append(figure("Which", sub, plot("ranking", specs) + more))
    if evidence.example is not None and evidence.example.traces:
        sub = f"held-out episode {evidence.example.episode}, before and after the repair"
        drawn = _traces(report, evidence.example, 0, FIRST_TRACES, specs)
        parts.append(figure("How far", sub, _key(report, evidence.example) + drawn))
    return f'<div class="first">{"".join(parts)}</div>' if parts else ""


def _strip(report: Report, example: Example | None, model: mujoco.MjModel | None, specs: dict[str, Spec]) -> str:
    """Return the filmstrip and the traces that the first screen had no room for."""
    if example is None:
        return ""
    pictures = filmstrip(model, example, words.after_name(report))
    rest = _traces(report, example, FIRST_TRACES, len(example.traces), specs)
    if not pictures and not rest:
        return ""
    sub = f"episode {example.episode}: the recording beside the simulation of the same commands"
    return f'<div class="strip">{figure("Before and after", sub, pictures + rest)}</div>'


def _traces(report: Report, example: Example, first: int, last: int, specs: dict[str, Spec]) -> str:
    """Return the traces `first` to `last` as small multiples; adds their specifications."""
    cells = []
    for number, one in list(enumerate(example.traces))[first:last]:
        name = f"trace{number}"
        specs[name] = figures.trace(example.time_s, one, words.after_name(report))
        label = f"{words.plain(one.channel)} {one.element}".strip()
        unit = f" <small>[{escape(one.unit)}]</small>" if one.unit else ""
        cells.append(f"<div><p>{escape(label)}{unit}</p>{plot(name, specs)}</div>")
    return f'<div class="traces">{"".join(cells)}</div>' if cells else ""


def _episodes(report: Report, evidence: Evidence, specs: dict[str, Spec]) -> str:
    """Return the table of symptoms beside the losses of every held-out episode."""
    parts = []
    if report.where:
        parts.append(f"<section><h2>Where it shows</h2>{tables.symptoms(report)}</section>")
    if evidence.losses is not None and len(evidence.losses.ids):
        specs["losses"] = figures.losses(evidence.losses, words.after_name(report))
        sub = "each held-out episode; the band is what noise alone gives"
        drawn = figure("Loss before and after", sub, plot("losses", specs))
        parts.append(f"<section><h2>Every episode</h2>{drawn}</section>")
    return f'<div class="two">{"".join(parts)}</div>' if len(parts) == 2 else "".join(parts)


def _file(effects_yaml: str) -> str:
    """Return `effects.yaml` with a copy button."""
    text = effects_yaml.strip() or "effects: []"
    return (
        "<h2>The repaired simulator: effects.yaml</h2>"
        '<div class="file"><button id="copy" type="button">Copy</button>'
        f'<pre id="effects-file" tabindex="0">{escape(text)}\n</pre></div>'
    )


def _key(report: Report, example: Example) -> str:
    """Return the legend of the traces."""
    names = [("recorded", "recorded"), ("nominal", "nominal")]
    if any(one.after is not None for one in example.traces):
        names.append(("repaired", words.after_name(report)))
    spans = "".join(f'<span class="{kind}">{escape(name)}</span>' for kind, name in names)
    return f'<p class="sub key">{spans}</p>'


def _clipped(share: float) -> float:
    """Return a share as a percentage between 0 and 100."""
    return 100 * min(max(share, 0.0), 1.0)
