"""The page of an evaluation: models, simulators and baselines side by side; and the summary for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from candata.datasets.writing import write_text
from candata.reports import courses
from candata.reports import evaluation_tables as tables
from candata.reports.document import render_page
from candata.reports.numbers import percent
from candata.reports.standing import best_model, certainty, standing
from candata.training.results import Evaluation, Track

#: Errors drawn over the horizon: title, field of `WindowScores`, factor from SI to the unit shown, and how to read it.
HORIZON_FIGURES = (
    ("Position", "position_error_m", 1e3, "mm", "distance; thin dots: energy score of the best model's samples"),
    ("Rotation", "rotation_error_rad", 180 / math.pi, "°", "angle to the recorded attitude"),
    ("ADD-S", "adds_m", 1e3, "mm", "distance between the surfaces, blind to symmetry"),
)
#: How joints move that follow a servo lag.
SERVO_WORDS = "each joint a first-order lag, gain and offset"


@dataclass(frozen=True)
class ClosedLoop:
    """What the page shows of one episode: its scores in words, its paths in space, its contact, its pictures."""

    episode: str
    scores: str
    paths: Markup
    contact: Markup


@dataclass(frozen=True)
class SampledLoops:
    """Closed loops of one episode that each followed one sample: title, how to read it, and a chart a coordinate."""

    title: str
    sub: str
    charts: Sequence[tuple[str, Markup]]


def write_evaluation(
    evaluation: Evaluation, tracks: Sequence[Track], out: Path, films: Mapping[str, Markup] | None = None
) -> Path:
    """Return the path of `evaluation.html` after writing it and `evaluation.json` into `out`; each whole or not.

    Parameters
    ----------
    evaluation : Evaluation
    tracks : sequence of Track
        Episodes that are drawn.
    out : Path
        Folder.
    films : mapping of str to Markup, optional
        Filmstrips by episode, of `candata.reports.evaluation_film`.

    Raises
    ------
    SetupError
        When the folder cannot be written.
    """
    write_text(out / "evaluation.html", page(evaluation, tracks, films))
    write_text(out / "evaluation.json", evaluation.model_dump_json(indent=2) + "\n")
    return out / "evaluation.html"


def page(evaluation: Evaluation, tracks: Sequence[Track], films: Mapping[str, Markup] | None = None) -> str:
    """Return the whole page as text."""
    tone, headline = standing(evaluation)
    found = [
        tables.closed_loop_table(evaluation),
        tables.pairs_table(evaluation),
        tables.forecast_table(evaluation),
        tables.contact_table(evaluation),
        tables.long_loop_table(evaluation),
    ]
    return render_page(
        "evaluation",
        title=headline,
        tone=tone,
        headline=headline,
        kicker=f"{_who(evaluation)} on {_group_words(evaluation)} episodes of {evaluation.dataset}",
        meaning=_meaning(evaluation),
        answers=_answers(evaluation),
        tables=[table for table in found if table is not None],
        breakdowns=tables.breakdown_tables(evaluation),
        key=_key(evaluation),
        horizon_figures=_horizon_figures(evaluation),
        windows=evaluation.windows,
        closed_loops=[_closed_loop(evaluation, track) for track in tracks],
        sampled_loops=[_sampled_loops(evaluation, track) for track in tracks if track.sampled],
        films=films or {},
        episodes=courses.episodes(evaluation) if evaluation.pairs else "",
        models=tables.models_table(evaluation),
        method=_method(evaluation),
    )


def summary(evaluation: Evaluation) -> str:
    """Return what the command line prints: the headline, and one row a forecaster."""
    rows = [("", "ADD-S AUC", "within 5 cm", "final error", "error ahead", "contact F1")]
    for name, scores in evaluation.forecasters.items():
        loop, windows = scores.closed_loop, scores.windows
        ahead = f"{tables.mm(windows.position_error_m[-1])} at {_lead(evaluation, name)}"
        success = f"{loop.success.count}/{loop.success.total}"
        final = tables.mm(loop.final_position_error_m)
        rows.append((name, tables.share(loop.adds_auc), success, final, ahead, tables.f1(windows.contact)))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    note = f"closed loop over {evaluation.episodes} episodes ({evaluation.group}); joints {evaluation.joints_from}"
    notes = [note, *filter(None, (certainty(evaluation), *evaluation.notes))]
    return "\n".join([standing(evaluation)[1], "", *lines, "", *notes])


def _who(evaluation: Evaluation) -> str:
    """Return `first (contact_diffusion, step 4,000), second (mlp, step 4,000)`."""
    models = [f"{name} ({facts.model}, step {facts.step:,})" for name, facts in evaluation.models.items()]
    return ", ".join(models) or "simulators and baselines"


def _group_words(evaluation: Evaluation) -> str:
    """Return `the test`, or `all`."""
    return "all" if evaluation.group == "all" else f"the {evaluation.group}"


def _meaning(evaluation: Evaluation) -> str:
    """Return what was done, and how sure the headline is."""
    begins_s = (evaluation.begins_after - 1) / evaluation.rate_hz
    done = (
        f"{evaluation.episodes} episodes, forecast from their first {begins_s:.1f} s to their end: each forecaster "
        f"sees its own poses; actions are replayed from the recording, joints {_joints_words(evaluation)}."
    )
    return " ".join(filter(None, (done, certainty(evaluation))))


def _joints_words(evaluation: Evaluation) -> str:
    """Return where joints come from."""
    if evaluation.joints_from == "recorded":
        return "too"
    if evaluation.joints_from in evaluation.simulators:
        return f"are those of the {evaluation.joints_from}"
    return f"follow a servo lag fitted on training episodes ({evaluation.joints_from})"


def _answers(evaluation: Evaluation) -> list[tuple[str, str, str]]:
    """Return four questions on the best model, each with a number and a sentence."""
    name = best_model(evaluation)
    loop, windows = evaluation.forecasters[name].closed_loop, evaluation.forecasters[name].windows
    contact = "It does not forecast contact."
    if windows.contact:
        contact = f"of one forecast of {name}; AUROC {_plain(windows.contact.auroc)}."
    return [
        ("Closed-loop ADD-S AUC", tables.share(loop.adds_auc), f"of {name}; 0 to 0.1 m, over whole episodes."),
        (
            "Final position within 5 cm",
            percent(loop.success.share),
            f"{tables.count_of(loop.success)} episodes of {name}.",
        ),
        (
            f"Position error {_lead(evaluation, name)} ahead",
            tables.mm(windows.position_error_m[-1]),
            f"of one forecast of {name}.",
        ),
        ("Contact F1", tables.f1(windows.contact), contact),
    ]


def _plain(value: float | None) -> str:
    """Return a number with two decimals."""
    return tables.DASH if value is None else f"{value:.2f}"


def _lead(evaluation: Evaluation, name: str) -> str:
    """Return how far a forecaster looks ahead: `1.6 s`."""
    return tables.lead_time(evaluation, len(evaluation.forecasters[name].windows.position_error_m))


def _horizon_figures(evaluation: Evaluation) -> list[tuple[str, str, Markup]]:
    """Return title, subtitle and chart of each error over the horizon that was measured."""
    windows = next(iter(evaluation.forecasters.values())).windows
    return [
        (title, sub, courses.against_horizon(evaluation, measure, factor, unit))
        for title, measure, factor, unit, sub in HORIZON_FIGURES
        if any(value is not None for value in getattr(windows, measure))
    ]


def _closed_loop(evaluation: Evaluation, track: Track) -> ClosedLoop:
    """Return what the page shows of one episode."""
    scores = next(episode for episode in evaluation.by_episode if episode.id == track.id)
    name = best_model(evaluation)
    auc = f"ADD-S AUC {tables.share(scores.adds_auc[name])} of {name}, " if name in scores.adds_auc else ""
    words = f"{auc}the object moved {100 * scores.moved_m:.1f} cm"
    paths, contact = courses.course(track, name), courses.contact_timeline(track, evaluation.forecasters)
    return ClosedLoop(track.id, words, paths, contact)


def _sampled_loops(evaluation: Evaluation, track: Track) -> SampledLoops:
    """Return the loops of one episode that each followed one sample."""
    ((name, loops),) = track.sampled.items()
    sub = f"{len(loops)} closed loops of {name}, each along one sample of every forecast; black: recorded"
    if evaluation.simulators:
        sub += "; the simulators beside"
    return SampledLoops(track.id, sub, courses.sampled_loops(track, name, evaluation.forecasters))


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
    gaps = f"{e.gap_rows:,} rows are marked as missing or lie beyond a break: they count nowhere" if e.gap_rows else ""
    closed_loop = (
        f"begins after {e.begins_after} rows; a model does its steps, then the next forecast sees the poses that came "
        "of it; all begin at the same row and are scored at the same instants"
    )
    joints = {"recorded": "no servo is modelled"} | dict.fromkeys(e.simulators, "those of its free run")
    return [
        ("evaluated on", evaluated_on),
        ("gaps", gaps),
        ("steps", f"{rate:g} Hz; the mean of {e.samples} samples of {e.sampling_steps} steps; mean quaternions"),
        ("closed loop", closed_loop),
        ("actions", f"{e.actions_from}, those of the coming steps too where a model reads them"),
        ("joints", f"{e.joints_from}: {joints.get(e.joints_from, SERVO_WORDS)}; a simulator moves its own joints"),
        *(
            (name, f"run free from the row at which the loop begins, {tables.simulator_words(facts)}")
            for name, facts in e.simulators.items()
        ),
        ("ADD-S", "mean distance of the recorded cloud's points to the nearest forecast one; AUC at 0.1 m"),
        ("success", "final position within 5 cm of the recorded one; Wilson interval"),
        ("contact", "from a probability of 0.5 on; phases are those of the recorded contact"),
        *(("note", note) for note in e.notes),
        ("seed, candata", f"{e.seed}, {e.revision}"),
    ]
