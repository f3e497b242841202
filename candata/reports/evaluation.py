"""The page of an evaluation: a model beside the baselines; and the summary for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

from candata.datasets.writing import write_text
from candata.reports import courses
from candata.reports.courses import Spec
from candata.reports.document import document, figure, plot, plotly
from candata.reports.numbers import digits, percent
from candata.reports.tables import pairs, table
from candata.training.results import Contact, Evaluation, Gain, Scores, Success, Track

DASH = "\N{EN DASH}"
#: Columns of the two tables.
LOOP_HEAD = ("", "ADD-S AUC", "the model gains", "ADD-S", "final position error", "rotation error", "within 5 cm",
             "95 % interval", "contact F1")  # fmt: skip
FORECAST_HEAD = ("", "ADD-S AUC", "position error", "energy score", "rotation error", "contact F1")


def write_evaluation(found: Evaluation, tracks: Sequence[Track], out: Path) -> Path:
    """Return the path of `evaluation.html` after writing it and `evaluation.json` into `out`; each whole or not.

    Raises
    ------
    SetupError
        When the folder cannot be written.
    """
    write_text(out / "evaluation.html", page(found, tracks))
    write_text(out / "evaluation.json", found.model_dump_json(indent=2) + "\n")
    return out / "evaluation.html"


def page(found: Evaluation, tracks: Sequence[Track]) -> str:
    """Return the whole page as text."""
    specs: dict[str, Spec] = {}
    tone, headline = verdict(found)
    body = "".join(
        (
            f'<header><p class="kicker">{escape(_model(found))} on {escape(_the_group(found))} episodes of '
            f"{escape(found.dataset)}</p>"
            f'<h1>{escape(headline)}</h1><p class="meaning">{escape(_meaning(found))}</p></header>',
            _answers(found),
            "<h2>Beside the baselines</h2>",
            _tables(found),
            "<h2>Error against horizon</h2>",
            _horizon(found, specs),
            "<h2>Closed loops</h2>",
            _courses(found, tracks, specs),
            _every_episode(found, specs),
            "<h2>How this was measured</h2>",
            pairs(_manner(found)),
        )
    )
    return document(f"{headline}: {_model(found)}", tone, body, plotly(specs))


def verdict(found: Evaluation) -> tuple[str, str]:
    """Return a colour and the headline: how the model stands against the baselines in closed loop."""
    if not found.gain:
        return "none", "No ADD-S: not every object has a point cloud"
    gains = found.gain.values()
    if found.seen_episodes:
        return "none", f"No verdict: trained on {found.seen_episodes} of these {found.episodes} episodes"
    if all(gain.low is not None and gain.low > 0 for gain in gains):
        return "good", "Better than every baseline"
    if all(gain.value > 0 for gain in gains):
        return "part", "Ahead of every baseline, but not surely"
    return "bad", "No better than a baseline"


def summary(found: Evaluation) -> str:
    """Return what the command line prints: one row a forecaster."""
    head = ("", "ADD-S AUC", "within 5 cm", "final error", "error ahead", "contact F1")
    rows = []
    for name, one in found.forecasters.items():
        loop, ahead = one.closed_loop, one.windows.position_error_m[-1]
        rows.append(
            (
                name, _share(loop.adds_auc), f"{loop.success.count}/{loop.success.total}",
                _mm(loop.final_position_error_m), _mm(ahead), _f1(one.windows.contact),
            )
        )  # fmt: skip
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in (head, *rows)]
    note = f"closed loop over {found.episodes} episodes ({found.group}); error ahead: {_ahead(found)} of one forecast"
    seen = [f"{found.seen_episodes} of the episodes were trained on"] if found.seen_episodes else []
    return "\n".join([f"{verdict(found)[1]}: {_model(found)}", "", *lines, "", note, *seen])


def _model(found: Evaluation) -> str:
    """Return `contact_diffusion, step 4,000`."""
    return f"{found.model}, step {found.step:,}"


def _the_group(found: Evaluation) -> str:
    """Return `the test`, or `all`."""
    return "all" if found.group == "all" else f"the {found.group}"


def _meaning(found: Evaluation) -> str:
    """Return one sentence on what was done."""
    seen = f" {found.seen_episodes} of them were trained on." if found.seen_episodes else ""
    return (
        f"{found.episodes} episodes, forecast from their first {(found.history - 1) / found.rate_hz:.1f} s to their "
        f"end: the model sees its own poses, joints and actions are replayed from the recording.{seen}"
    )


def _answers(found: Evaluation) -> str:
    """Return four numbers in words."""
    model = found.forecasters[found.model]
    loop, best = model.closed_loop, _best_baseline(found)
    entries = [
        (
            "Closed-loop ADD-S AUC", _share(loop.adds_auc),
            f"against {_share(best.closed_loop.adds_auc)} when {best.summary}; 0 to 0.1 m, mean of "
            f"{found.samples} samples.",
        ),
        (
            "Final position within 5 cm", percent(loop.success.share),
            f"{_count(loop.success)}; 95 % interval {_interval(loop.success)}.",
        ),
        (
            f"Position error {_ahead(found)}", _mm(model.windows.position_error_m[-1]),
            f"of one forecast; {_mm(best.windows.position_error_m[-1])} when {best.summary}.",
        ),
        (
            "Contact F1", _f1(model.windows.contact),
            f"of one forecast; {_f1(best.windows.contact)} when contact stays as it is."
            if model.windows.contact else "The model does not forecast contact.",
        ),
    ]  # fmt: skip
    cells = (
        f'<div><dt>{escape(q)}</dt><dd><span class="lead big">{escape(lead)}</span>{escape(text)}</dd></div>'
        for q, lead, text in entries
    )
    return f'<dl class="answers">{"".join(cells)}</dl>'


def _best_baseline(found: Evaluation) -> Scores:
    """Return the baseline with the largest closed-loop AUC, or the least final error without ADD-S."""
    others = [one for name, one in found.forecasters.items() if name != found.model]
    return max(others, key=lambda one: (one.closed_loop.adds_auc or 0.0, -one.closed_loop.final_position_error_m))


def _tables(found: Evaluation) -> str:
    """Return both tables, one row a forecaster, the model's first: whole episodes, then single forecasts."""
    loops, forecasts = [], []
    for name, one in found.forecasters.items():
        loop, opened, gain = one.closed_loop, one.windows, found.gain.get(name)
        loops.append(
            (
                one.summary, _share(loop.adds_auc), _gained(gain), _mm(loop.adds_m), _mm(loop.final_position_error_m),
                _degrees(loop.rotation_error_rad), _count(loop.success), _interval(loop.success), _f1(loop.contact),
            )
        )  # fmt: skip
        ahead = (opened.position_error_m[-1], opened.position_energy_m[-1], opened.rotation_error_rad[-1])
        forecasts.append(
            (
                one.summary, _share(opened.adds_auc), _mm(ahead[0]), _mm(ahead[1]), _degrees(ahead[2]),
                _f1(opened.contact),
            )
        )  # fmt: skip
    return (
        "<h3>Closed loop, whole episodes</h3>"
        + table(LOOP_HEAD, loops, numeric=range(1, len(LOOP_HEAD)))
        + '<p class="note">Gains in points of AUC, with a 95 % interval over resampled episodes where there are 8 or '
        "more. All go through the same code.</p><br>"
        + f"<h3>One forecast from each window; errors {escape(_ahead(found))}</h3>"
        + table(FORECAST_HEAD, forecasts, numeric=range(1, len(FORECAST_HEAD)))
    )


def _horizon(found: Evaluation, specs: dict[str, Spec]) -> str:
    """Return position, rotation and ADD-S over the horizon."""
    drawn = [
        ("position", "Position", "position_error_m", 1e3, "mm", "distance; thin dots: energy score of the samples"),
        ("rotation", "Rotation", "rotation_error_rad", 180 / math.pi, "°", "angle to the recorded attitude"),
        ("adds", "ADD-S", "adds_m", 1e3, "mm", "distance between the surfaces, blind to symmetry"),
    ]
    parts = []
    for key, title, measure, factor, unit, sub in drawn:
        if all(value is None for value in getattr(found.forecasters[found.model].windows, measure)):
            continue
        specs[key] = courses.against_horizon(found, measure, factor, unit)
        parts.append(figure(title, f"{sub}, mean over {found.windows:,} windows", plot(key, specs)))
    return _key(found) + f'<div class="first">{"".join(parts)}</div>'


def _courses(found: Evaluation, tracks: Sequence[Track], specs: dict[str, Spec]) -> str:
    """Return the 3D paths of a few episodes, each above its contact."""
    cells = []
    for number, track in enumerate(tracks):
        specs[f"course{number}"] = courses.course(track)
        inner = plot(f"course{number}", specs)
        if track.contact is not None or track.forecast_contact is not None:
            specs[f"contact{number}"] = courses.timeline(track)
            inner += '<p class="sub">Contact: recorded (grey), forecast</p>' + plot(f"contact{number}", specs)
        scores = next(one for one in found.by_episode if one.id == track.id)
        auc = f"ADD-S AUC {_share(scores.adds_auc.get(found.model))}, " if scores.adds_auc else ""
        sub = f"{auc}the object moved {100 * scores.moved_m:.1f} cm"
        cells.append(figure(track.id, sub, inner))
    note = (
        "Paths of the object's origin. The episodes are spread evenly from the model's worst to its best; "
        "drag to turn. A baseline that flies off leaves the box."
    )
    grid = f'<div class="two courses">{"".join(cells)}</div>'
    return _key(found, recorded=True) + grid + f'<p class="note">{note}</p>'


def _every_episode(found: Evaluation, specs: dict[str, Spec]) -> str:
    """Return all episodes over how far their object moved."""
    if not found.gain:
        return ""
    specs["episodes"] = courses.episodes(found)
    inner = _key(found) + plot("episodes", specs)
    return "<h2>Every episode</h2>" + figure("ADD-S AUC in closed loop", "a mark a forecaster and episode", inner)


def _key(found: Evaluation, recorded: bool = False) -> str:
    """Return the legend: names in their colours."""
    colours = courses.names_of(found.forecasters)
    spans = [("recorded", "ink")] if recorded else []
    spans += [(one.summary, colours[name]) for name, one in found.forecasters.items()]
    inner = "".join(f'<span style="color:var(--{colour})">{escape(text)}</span>' for text, colour in spans)
    return f'<p class="sub key">{inner}</p>'


def _manner(found: Evaluation) -> list[tuple[str, str]]:
    """Return what a reader must know to judge the numbers."""
    rate = found.rate_hz
    contact = {
        "predicted": "the model's own forecast, 0.5 and above counting as contact",
        "recorded": "replayed from the recording: the model reads contact but does not forecast it",
        "predicted, fingertips recorded": "the hand's as the model forecasts it, 0.5 and above counting as contact; "
        "each fingertip's replayed from the recording",
        "not read": "the model does not read contact",
    }[found.contact_from]
    return [
        ("checkpoint", f"{found.run}/{found.checkpoint}, averaged weights of step {found.step:,}"),
        ("trained on", found.trained_on),
        ("evaluated on", f"{found.dataset}, group {found.group} of the split {found.split}: {found.episodes} episodes, "
         f"{found.windows:,} windows, {found.rows:,} rows in closed loop"),
        ("trained on these", _seen(found)),
        ("forecasts", f"{found.horizon} steps at {rate:g} Hz from {found.history} rows of history; the mean of "
         f"{found.samples} samples of {found.sampling_steps} steps; rotations by the mean quaternion"),
        ("closed loop", f"begins with a whole history; {found.execute} steps ({found.execute / rate:g} s) are done, "
         "then the next forecast sees the poses that came of it"),
        ("joints and actions", f"{found.joints_from}, those of the coming steps too: no servo is modelled"),
        ("contact fed back", contact),
        ("ADD-S", "mean distance of the recorded cloud's points to the nearest forecast one; AUC at 0.1 m"),
        ("success", "final position within 5 cm of the recorded one; Wilson interval"),
        ("seed, candata", f"{found.seed}, {found.revision}"),
    ]  # fmt: skip


def _seen(found: Evaluation) -> str:
    """Return how many of the episodes the model was trained on."""
    if found.seen_episodes is None:
        return "not known: the run's split is not beside the checkpoint"
    return f"{found.seen_episodes} episodes" if found.seen_episodes else "none"


def _ahead(found: Evaluation) -> str:
    """Return `1.6 s ahead`."""
    return f"{found.horizon / found.rate_hz:g} s ahead"


def _share(value: float | None) -> str:
    """Return a share as a percentage with one decimal."""
    return DASH if value is None else f"{100 * value:.1f} %"


def _mm(value: float | None) -> str:
    """Return a length in millimetres."""
    return DASH if value is None else f"{digits(1e3 * value)} mm"


def _degrees(value: float | None) -> str:
    """Return an angle in degrees."""
    return DASH if value is None else f"{digits(math.degrees(value))}°"


def _f1(contact: Contact | None) -> str:
    """Return the F1, or a dash."""
    return DASH if contact is None or contact.f1 is None else f"{contact.f1:.3f}"


def _gained(gain: Gain | None) -> str:
    """Return `+2.1 (+0.3 to +4.0)`, in points."""
    if gain is None:
        return DASH
    interval = "" if gain.low is None or gain.high is None else f" ({100 * gain.low:+.1f} to {100 * gain.high:+.1f})"
    return f"{100 * gain.value:+.1f}{interval}"


def _count(success: Success) -> str:
    """Return `14 of 19`."""
    return f"{success.count} of {success.total}"


def _interval(success: Success) -> str:
    """Return `51 to 88 %`."""
    return f"{100 * success.low:.0f} to {100 * success.high:.0f} %"
