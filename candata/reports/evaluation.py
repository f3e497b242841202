"""The page of an evaluation: a model beside the baselines; and the summary for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from candata.datasets.writing import write_text
from candata.reports import courses
from candata.reports.document import render_page
from candata.reports.numbers import digits, percent
from candata.training.results import Contact, Evaluation, Gain, Scores, Success, Track

DASH = "\N{EN DASH}"
#: Columns of the two tables.
LOOP_HEAD = (
    "",
    "ADD-S AUC",
    "the model gains",
    "ADD-S",
    "final position error",
    "rotation error",
    "within 5 cm",
    "95 % interval",
    "contact F1",
)
FORECAST_HEAD = ("", "ADD-S AUC", "position error", "energy score", "rotation error", "contact F1")
#: Errors drawn over the horizon: title, field of `WindowScores`, factor from SI to the unit shown, and how to read it.
HORIZON_FIGURES = (
    ("Position", "position_error_m", 1e3, "mm", "distance; thin dots: energy score of the samples"),
    ("Rotation", "rotation_error_rad", 180 / math.pi, "°", "angle to the recorded attitude"),
    ("ADD-S", "adds_m", 1e3, "mm", "distance between the surfaces, blind to symmetry"),
)
#: Origin of the contact that the model is fed, in words.
CONTACT_SOURCES = {
    "predicted": "the model's own forecast, 0.5 and above counting as contact",
    "recorded": "replayed from the recording: the model reads contact but does not forecast it",
    "predicted, fingertips recorded": "the hand's as the model forecasts it, 0.5 and above counting as contact; "
    "each fingertip's replayed from the recording",
    "not read": "the model does not read contact",
}


@dataclass(frozen=True)
class ClosedLoop:
    """What the page shows of one episode: its scores in words, its paths in space, its contact."""

    episode: str
    scores: str
    paths: Markup
    contact: Markup


def write_evaluation(evaluation: Evaluation, tracks: Sequence[Track], out: Path) -> Path:
    """Return the path of `evaluation.html` after writing it and `evaluation.json` into `out`; each whole or not.

    Raises
    ------
    SetupError
        When the folder cannot be written.
    """
    write_text(out / "evaluation.html", page(evaluation, tracks))
    write_text(out / "evaluation.json", evaluation.model_dump_json(indent=2) + "\n")
    return out / "evaluation.html"


def page(evaluation: Evaluation, tracks: Sequence[Track]) -> str:
    """Return the whole page as text."""
    tone, headline = verdict(evaluation)
    return render_page(
        "evaluation",
        title=f"{headline}: {_model(evaluation)}",
        tone=tone,
        headline=headline,
        kicker=f"{_model(evaluation)} on {_group_words(evaluation)} episodes of {evaluation.dataset}",
        meaning=_meaning(evaluation),
        answers=_answers(evaluation),
        loop_head=LOOP_HEAD,
        loops=[_loop_row(evaluation, name) for name in evaluation.forecasters],
        forecast_head=FORECAST_HEAD,
        forecasts=[_forecast_row(scores) for scores in evaluation.forecasters.values()],
        lead_time=_lead_time(evaluation),
        key=_key(evaluation),
        horizon_figures=_horizon_figures(evaluation),
        windows=evaluation.windows,
        closed_loops=[_closed_loop(evaluation, track) for track in tracks],
        episodes=courses.episodes(evaluation) if evaluation.gain else "",
        method=_method(evaluation),
    )


def verdict(evaluation: Evaluation) -> tuple[str, str]:
    """Return a colour and the headline: how the model stands against the baselines in closed loop."""
    if not evaluation.gain:
        return "none", "No ADD-S: not every object has a point cloud"
    gains = evaluation.gain.values()
    if evaluation.seen_episodes:
        return "none", f"No verdict: trained on {evaluation.seen_episodes} of these {evaluation.episodes} episodes"
    if all(gain.low is not None and gain.low > 0 for gain in gains):
        return "good", "Better than every baseline"
    if all(gain.value > 0 for gain in gains):
        return "part", "Ahead of every baseline, but not surely"
    return "bad", "No better than a baseline"


def summary(evaluation: Evaluation) -> str:
    """Return what the command line prints: one row a forecaster."""
    rows = [("", "ADD-S AUC", "within 5 cm", "final error", "error ahead", "contact F1")]
    for name, scores in evaluation.forecasters.items():
        loop, windows = scores.closed_loop, scores.windows
        auc, success = _share(loop.adds_auc), f"{loop.success.count}/{loop.success.total}"
        errors = (_mm(loop.final_position_error_m), _mm(windows.position_error_m[-1]))
        rows.append((name, auc, success, *errors, _f1(windows.contact)))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    note = (
        f"closed loop over {evaluation.episodes} episodes ({evaluation.group}); "
        f"error ahead: {_lead_time(evaluation)} of one forecast"
    )
    seen_count = evaluation.seen_episodes
    seen_lines = [f"{seen_count} of the episodes were trained on"] if seen_count else []
    return "\n".join([f"{verdict(evaluation)[1]}: {_model(evaluation)}", "", *lines, "", note, *seen_lines])


def _model(evaluation: Evaluation) -> str:
    """Return `contact_diffusion, step 4,000`."""
    return f"{evaluation.model}, step {evaluation.step:,}"


def _group_words(evaluation: Evaluation) -> str:
    """Return `the test`, or `all`."""
    return "all" if evaluation.group == "all" else f"the {evaluation.group}"


def _meaning(evaluation: Evaluation) -> str:
    """Return one sentence on what was done."""
    seen_words = f" {evaluation.seen_episodes} of them were trained on." if evaluation.seen_episodes else ""
    history_s = (evaluation.history - 1) / evaluation.rate_hz
    return (
        f"{evaluation.episodes} episodes, forecast from their first {history_s:.1f} s to their end: the model sees its "
        f"own poses, joints and actions are replayed from the recording.{seen_words}"
    )


def _answers(evaluation: Evaluation) -> list[tuple[str, str, str]]:
    """Return four questions, each with a number and a sentence."""
    model = evaluation.forecasters[evaluation.model]
    loop, windows, baseline = model.closed_loop, model.windows, _best_baseline(evaluation)
    contact = "The model does not forecast contact."
    if windows.contact:
        contact = f"of one forecast; {_f1(baseline.windows.contact)} when contact stays as it is."
    return [
        (
            "Closed-loop ADD-S AUC",
            _share(loop.adds_auc),
            f"against {_share(baseline.closed_loop.adds_auc)} when {baseline.summary}; 0 to 0.1 m, mean of "
            f"{evaluation.samples} samples.",
        ),
        (
            "Final position within 5 cm",
            percent(loop.success.share),
            f"{_count(loop.success)}; 95 % interval {_interval(loop.success)}.",
        ),
        (
            f"Position error {_lead_time(evaluation)}",
            _mm(windows.position_error_m[-1]),
            f"of one forecast; {_mm(baseline.windows.position_error_m[-1])} when {baseline.summary}.",
        ),
        ("Contact F1", _f1(windows.contact), contact),
    ]


def _best_baseline(evaluation: Evaluation) -> Scores:
    """Return the baseline with the largest closed-loop AUC, or the least final error without ADD-S."""
    baselines = [scores for name, scores in evaluation.forecasters.items() if name != evaluation.model]
    return max(baselines, key=lambda s: (s.closed_loop.adds_auc or 0.0, -s.closed_loop.final_position_error_m))


def _loop_row(evaluation: Evaluation, name: str) -> tuple[str, ...]:
    """Return a forecaster's row of the table over whole episodes."""
    scores = evaluation.forecasters[name]
    loop = scores.closed_loop
    return (
        scores.summary,
        _share(loop.adds_auc),
        _gain(evaluation.gain.get(name)),
        _mm(loop.adds_m),
        _mm(loop.final_position_error_m),
        _degrees(loop.rotation_error_rad),
        _count(loop.success),
        _interval(loop.success),
        _f1(loop.contact),
    )


def _forecast_row(scores: Scores) -> tuple[str, ...]:
    """Return a forecaster's row of the table over single forecasts."""
    windows = scores.windows
    return (
        scores.summary,
        _share(windows.adds_auc),
        _mm(windows.position_error_m[-1]),
        _mm(windows.position_energy_m[-1]),
        _degrees(windows.rotation_error_rad[-1]),
        _f1(windows.contact),
    )


def _horizon_figures(evaluation: Evaluation) -> list[tuple[str, str, Markup]]:
    """Return title, subtitle and chart of each error over the horizon that was measured."""
    windows = evaluation.forecasters[evaluation.model].windows
    return [
        (title, sub, courses.against_horizon(evaluation, measure, factor, unit))
        for title, measure, factor, unit, sub in HORIZON_FIGURES
        if any(value is not None for value in getattr(windows, measure))
    ]


def _closed_loop(evaluation: Evaluation, track: Track) -> ClosedLoop:
    """Return what the page shows of one episode."""
    scores = next(episode for episode in evaluation.by_episode if episode.id == track.id)
    auc = f"ADD-S AUC {_share(scores.adds_auc.get(evaluation.model))}, " if scores.adds_auc else ""
    words = f"{auc}the object moved {100 * scores.moved_m:.1f} cm"
    return ClosedLoop(track.id, words, courses.course(track), courses.contact_timeline(track))


def _key(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Return class and name of each forecaster's marks."""
    classes = courses.forecaster_classes(evaluation.forecasters)
    return [(f"key-{classes[name]}", scores.summary) for name, scores in evaluation.forecasters.items()]


def _method(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Return what a reader must know to judge the numbers."""
    e, rate = evaluation, evaluation.rate_hz
    evaluated_on = (
        f"{e.dataset}, group {e.group} of the split {e.split}: {e.episodes} episodes, {e.windows:,} windows, "
        f"{e.rows:,} rows in closed loop"
    )
    forecasts = (
        f"{e.horizon} steps at {rate:g} Hz from {e.history} rows of history; the mean of {e.samples} samples of "
        f"{e.sampling_steps} steps; rotations by the mean quaternion"
    )
    closed_loop = (
        f"begins with a whole history; {e.execute} steps ({e.execute / rate:g} s) are done, then the next forecast "
        "sees the poses that came of it"
    )
    return [
        ("checkpoint", f"{e.run}/{e.checkpoint}, averaged weights of step {e.step:,}"),
        ("trained on", e.trained_on),
        ("evaluated on", evaluated_on),
        ("trained on these", _seen_words(e)),
        ("forecasts", forecasts),
        ("closed loop", closed_loop),
        ("joints and actions", f"{e.joints_from}, those of the coming steps too: no servo is modelled"),
        ("contact fed back", CONTACT_SOURCES[e.contact_from]),
        ("ADD-S", "mean distance of the recorded cloud's points to the nearest forecast one; AUC at 0.1 m"),
        ("success", "final position within 5 cm of the recorded one; Wilson interval"),
        ("seed, candata", f"{e.seed}, {e.revision}"),
    ]


def _seen_words(evaluation: Evaluation) -> str:
    """Return how many of the episodes the model was trained on."""
    if evaluation.seen_episodes is None:
        return "not known: the run's split is not beside the checkpoint"
    return f"{evaluation.seen_episodes} episodes" if evaluation.seen_episodes else "none"


def _lead_time(evaluation: Evaluation) -> str:
    """Return `1.6 s ahead`."""
    return f"{evaluation.horizon / evaluation.rate_hz:g} s ahead"


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


def _gain(gain: Gain | None) -> str:
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
