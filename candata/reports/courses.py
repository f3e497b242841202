"""Charts of an evaluation: errors against the horizon, paths and contact of closed loops, every episode."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from candata.reports import space
from candata.reports.chart import Axis, areas, chart, dots, floats, join_markup, line, linear_axis, tooltip_strips
from candata.reports.envelope import runs
from candata.reports.standing import best_model
from candata.rotation import difference
from candata.training.forecasters import BASELINES
from candata.training.results import REPAIRED, SIMULATOR, EpisodeScores, Evaluation, Scores, Track

#: Classes of the forecasters' marks, in the order of an evaluation's rows.
CSS_CLASSES = tuple(f"forecaster{number}" for number in range(8))
#: Episodes that are drawn at most; of more, as many are taken, evenly spread.
MOST_EPISODES = 400
#: Coordinates of sampled loops, and the least range of their axes, so that noise at rest does not fill a chart.
COORDINATES = {"x [cm]": 2.0, "y [cm]": 2.0, "z [cm]": 2.0, "angle turned since the loop began [°]": 10.0}


def forecaster_classes(forecasters: Mapping[str, object]) -> dict[str, str]:
    """Return forecaster to the class of its marks."""
    return {name: CSS_CLASSES[number % len(CSS_CLASSES)] for number, name in enumerate(forecasters)}


def against_horizon(evaluation: Evaluation, measure: str, factor: float, unit: str) -> Markup:
    """Return a measure of all forecasters over the steps of the horizon; each line ends with its own horizon.

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
    best = best_model(evaluation)
    if measure == "position_error_m" and evaluation.samples > 1 and best in evaluation.models:
        energy = _in_unit(evaluation.forecasters[best].windows.position_energy_m, factor)
        place = list(evaluation.forecasters).index(best) + 1
        lines.insert(place, (f"energy score of the samples of {best}", f"{classes[best]} energy", energy))
    longest = max(len(values) for _, _, values in lines)
    lines = [(name, mark, [*values, *[math.nan] * (longest - len(values))]) for name, mark, values in lines]
    times = [(k + 1) / evaluation.rate_hz for k in range(longest)]
    x = linear_axis(times, 5)
    y = linear_axis([v for _, _, values in lines for v in values], 7, f" {unit}", include=(0.0,))
    tooltips = []
    for k, time in enumerate(times):
        texts = [f"{name}: {values[k]:.3g} {unit}" for name, _, values in lines if math.isfinite(values[k])]
        tooltips.append("\n".join([f"{time:g} s ahead", *texts]))
    marks = join_markup(line(x, y, times, values, css_class) for _, css_class, values in reversed(lines))
    label = f"{measure.rsplit('_', 1)[0].replace('_', ' ')} against the horizon"
    return chart(x, y, marks + tooltip_strips(x, times, tooltips), label, 190, "seconds ahead")


def _in_unit(values: Sequence[float | None], factor: float) -> list[float]:
    """Return values times a factor, NaN for what is missing."""
    return [math.nan if value is None else factor * value for value in values]


def course(track: Track, held_name: str) -> Markup:
    """Return the paths of the object's origin in space: recorded, and each forecaster's.

    The box holds the recorded one and that of `held_name`, which lies on top; the others may leave it.
    """
    classes = forecaster_classes(track.poses)
    order = [name for name in reversed(track.poses) if name != held_name]
    positions = {"recorded": track.truth[:, :3]}
    positions |= {name: track.poses[name][:, :3] for name in (*order, held_name)}
    return space.paths(positions, track.time_s, classes | {"recorded": "truth"}, ("recorded", held_name))


def contact_timeline(track: Track, forecasters: Mapping[str, object]) -> Markup:
    """Return recorded contact as areas, and the forecast probabilities as lines; empty without either.

    Lines are those of models and simulators; baselines keep the contact that they begin with.
    """
    shown = {name: values for name, values in track.forecast_contact.items() if name not in BASELINES}
    if track.contact is None and not shown:
        return Markup("")
    classes, times = forecaster_classes(forecasters), floats(track.time_s)
    x, y = linear_axis(times, 6, " s"), Axis(-0.04, 1.08, ((0.0, "0"), (1.0, "1")))
    marks, texts = [], [[f"{time:g} s"] for time in times]
    if track.contact is not None:
        marks.append(
            areas(x, [(times[a], times[min(b, len(times) - 1)]) for a, b in runs(track.contact)], "recorded-contact")
        )
        texts = [[*text, f"recorded: {int(flag)}"] for text, flag in zip(texts, track.contact, strict=True)]
    for name, values in shown.items():
        marks.append(line(x, y, times, floats(values), classes[name]))
        forecasts = zip(texts, values, strict=True)
        texts = [text if math.isnan(p) else [*text, f"{name}: {p:.2f}"] for text, p in forecasts]
    marks.append(tooltip_strips(x, times, ["\n".join(text) for text in texts]))
    return chart(x, y, join_markup(marks), f"contact in {track.id}", 58)


def sampled_loops(track: Track, name: str, forecasters: Mapping[str, object]) -> list[tuple[str, Markup]]:
    """Return a chart a coordinate: the sampled loops of a model over time, its mean's, the recorded one.

    Where a simulator took part, its loop is drawn too.
    """
    classes, times = forecaster_classes(forecasters), floats(track.time_s)
    simulated = [each for each in (SIMULATOR, REPAIRED) if each in track.poses]
    rows = [(f"{classes[name]} sample", _coordinates(loop, track.truth[0])) for loop in track.sampled[name]]
    rows += [(classes[each], _coordinates(track.poses[each], track.truth[0])) for each in simulated]
    rows += [(classes[name], _coordinates(track.poses[name], track.truth[0]))]
    rows += [("truth", _coordinates(track.truth, track.truth[0]))]
    x, charts = linear_axis(times, 6, " s"), []
    for k, (title, least_range) in enumerate(COORDINATES.items()):
        begin = rows[-1][1][k][0]
        ends = (begin - least_range / 2, begin + least_range / 2)
        y = linear_axis([v for _, values in rows for v in values[k]], 5, include=ends)
        marks = join_markup(line(x, y, times, values[k], css_class) for css_class, values in rows)
        charts.append((title, chart(x, y, marks, f"{title} of sampled loops in {track.id}", 110)))
    return charts


def _coordinates(poses: NDArray, begin: NDArray) -> list[list[float]]:
    """Return position [cm] and the angle turned [deg] of poses `(T, 7)`, a list a coordinate."""
    angle = np.degrees(np.linalg.norm(difference(poses[:, 3:], np.broadcast_to(begin[3:], poses[:, 3:].shape)), axis=1))
    return [*(floats(100 * poses[:, k]) for k in range(3)), floats(angle)]


def episodes(evaluation: Evaluation) -> Markup:
    """Return each episode's ADD-S AUC over how far its object moved, by forecaster."""
    classes = forecaster_classes(evaluation.forecasters)
    count = min(MOST_EPISODES, len(evaluation.by_episode))
    places = np.linspace(0, len(evaluation.by_episode) - 1, count).round().astype(int)
    drawn = [evaluation.by_episode[k] for k in places.tolist()]
    moved_cm = [100 * episode.moved_m for episode in drawn]
    shares = [100 * share for episode in drawn for share in episode.adds_auc.values()]
    x, y = linear_axis(moved_cm, 10, include=(0.0,)), linear_axis(shares, 7, " %")
    forecasters = reversed(list(evaluation.forecasters.items()))
    marks = join_markup(_episode_dots(drawn, name, scores, classes[name], x, y) for name, scores in forecasters)
    return chart(x, y, marks, "ADD-S AUC of every episode", 250, "largest motion of the object [cm]")


def _episode_dots(
    drawn: Sequence[EpisodeScores], name: str, scores: Scores, css_class: str, x: Axis, y: Axis
) -> Markup:
    """Return a mark for each episode of one forecaster."""
    scores_by_episode = [episode for episode in drawn if name in episode.adds_auc]
    xs, ys = [100 * e.moved_m for e in scores_by_episode], [100 * e.adds_auc[name] for e in scores_by_episode]

    def tooltip(k: int) -> str:
        return f"{scores_by_episode[k].id}\n{scores.summary}: {ys[k]:.1f} %\nmoved {xs[k]:.1f} cm"

    return dots(x, y, xs, ys, css_class, tooltip)
