"""Charts of an evaluation: errors against the horizon, paths and contact of closed loops, every episode."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from candata.reports import space
from candata.reports.chart import Axis, areas, chart, dots, floats, join_markup, line, linear_axis, tooltip_strips
from candata.reports.envelope import runs
from candata.training.results import Evaluation, Scores, Track

#: Classes of the forecasters in the order of an evaluation: the model, then the baselines.
CSS_CLASSES = ("forecaster0", "forecaster1", "forecaster2")


def forecaster_classes(forecasters: Mapping[str, object]) -> dict[str, str]:
    """Return forecaster to the class of its marks."""
    return {name: CSS_CLASSES[number % len(CSS_CLASSES)] for number, name in enumerate(forecasters)}


def against_horizon(evaluation: Evaluation, measure: str, factor: float, unit: str) -> Markup:
    """Return a measure of all forecasters over the steps of the horizon.

    Parameters
    ----------
    evaluation : Evaluation
        The scores.
    measure : str
        Field of `WindowScores` that holds a value a step.
    factor, unit : float, str
        From SI to the unit shown.
    """
    classes = forecaster_classes(evaluation.forecasters)
    lines = [
        (scores.summary, classes[name], _in_unit(getattr(scores.windows, measure), factor))
        for name, scores in evaluation.forecasters.items()
    ]
    if measure == "position_error_m" and evaluation.samples > 1:
        energy = _in_unit(evaluation.forecasters[evaluation.model].windows.position_energy_m, factor)
        lines.insert(1, ("energy score of its samples", f"{classes[evaluation.model]} energy", energy))
    times = [(k + 1) / evaluation.rate_hz for k in range(len(lines[0][2]))]
    x = linear_axis(times, 5)
    y = linear_axis([v for _, _, values in lines for v in values], 7, f" {unit}", include=(0.0,))
    tooltips = [
        "\n".join([f"{time:g} s ahead", *(f"{name}: {values[k]:.3g} {unit}" for name, _, values in lines)])
        for k, time in enumerate(times)
    ]
    marks = join_markup(line(x, y, times, values, css_class) for _, css_class, values in reversed(lines))
    label = f"{measure.rsplit('_', 1)[0].replace('_', ' ')} against the horizon"
    return chart(x, y, marks + tooltip_strips(x, times, tooltips), label, 190, "seconds ahead")


def _in_unit(values: Sequence[float | None], factor: float) -> list[float]:
    """Return values times a factor, NaN for what is missing."""
    return [math.nan if value is None else factor * value for value in values]


def course(track: Track) -> Markup:
    """Return the paths of the object's origin in space: recorded, the model's, the baselines'."""
    classes = forecaster_classes(track.poses)
    model, *baselines = track.poses
    positions = {"recorded": track.truth[:, :3]}
    positions |= {name: track.poses[name][:, :3] for name in (*reversed(baselines), model)}
    return space.paths(positions, track.time_s, classes | {"recorded": "truth"}, ("recorded", model))


def contact_timeline(track: Track) -> Markup:
    """Return recorded contact as areas, and the model's probability of contact as a line; empty without either."""
    if track.contact is None and track.forecast_contact is None:
        return Markup("")
    times = floats(track.time_s)
    x, y = linear_axis(times, 6, " s"), Axis(-0.04, 1.08, ((0.0, "0"), (1.0, "1")))
    marks, texts = [], [[f"{time:g} s"] for time in times]
    if track.contact is not None:
        marks.append(
            areas(x, [(times[a], times[min(b, len(times) - 1)]) for a, b in runs(track.contact)], "recorded-contact")
        )
        texts = [[*text, f"recorded: {int(flag)}"] for text, flag in zip(texts, track.contact, strict=True)]
    if track.forecast_contact is not None:
        marks.append(line(x, y, times, floats(track.forecast_contact), "forecaster0"))
        forecasts = zip(texts, track.forecast_contact, strict=True)
        texts = [text if math.isnan(p) else [*text, f"forecast: {p:.2f}"] for text, p in forecasts]
    marks.append(tooltip_strips(x, times, ["\n".join(text) for text in texts]))
    return chart(x, y, join_markup(marks), f"contact in {track.id}", 58)


def episodes(evaluation: Evaluation) -> Markup:
    """Return each episode's ADD-S AUC over how far its object moved, by forecaster."""
    classes = forecaster_classes(evaluation.forecasters)
    moved_cm = [100 * episode.moved_m for episode in evaluation.by_episode]
    shares = [100 * share for episode in evaluation.by_episode for share in episode.adds_auc.values()]
    x, y = linear_axis(moved_cm, 10, include=(0.0,)), linear_axis(shares, 7, " %")
    forecasters = reversed(list(evaluation.forecasters.items()))
    marks = join_markup(_episode_dots(evaluation, name, scores, classes[name], x, y) for name, scores in forecasters)
    return chart(x, y, marks, "ADD-S AUC of every episode", 250, "largest motion of the object [cm]")


def _episode_dots(evaluation: Evaluation, name: str, scores: Scores, css_class: str, x: Axis, y: Axis) -> Markup:
    """Return a mark for each episode of one forecaster."""
    scores_by_episode = [episode for episode in evaluation.by_episode if name in episode.adds_auc]
    xs, ys = [100 * e.moved_m for e in scores_by_episode], [100 * e.adds_auc[name] for e in scores_by_episode]

    def tooltip(k: int) -> str:
        return f"{scores_by_episode[k].id}\n{scores.summary}: {ys[k]:.1f} %\nmoved {xs[k]:.1f} cm"

    return dots(x, y, xs, ys, css_class, tooltip)
