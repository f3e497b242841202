"""Evaluation: per window and in closed loop, models, simulators and baselines through the same code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.loaders import Windows
from candata.loaders.increments import increments, integrate
from candata.training import metrics, tracks
from candata.training.breakdown import breakdown
from candata.training.contact_scores import contact_scores
from candata.training.forecasters import Forecaster
from candata.training.loop_errors import LoopErrors, area, closed_loop_scores, final_position_error, loop_errors
from candata.training.pairs import resampled_areas
from candata.training.poses import mean_pose, position_error, rotation_error
from candata.training.results import (
    ClosedLoopScores,
    EpisodeScores,
    Group,
    Pair,
    Track,
    WindowScores,
)
from candata.training.rollout import Course, close_loop, course

#: Windows that are forecast at most; of more, as many are taken, evenly spread.
MOST_WINDOWS = 4096


@dataclass(frozen=True)
class Entrant:
    """Who is evaluated.

    Attributes
    ----------
    forecaster : Forecaster
    windows : Windows
        The windows of all entrants, with its own history, horizon and channels.
    execute : int
        Steps executed before its next forecast in closed loop.
    one_sample : Forecaster or None
        Of a model that draws its samples: the same with one sample a forecast, whose loops are drawn beside the mean's.
    """

    forecaster: Forecaster
    windows: Windows
    execute: int
    one_sample: Forecaster | None = None


@dataclass(frozen=True)
class EvaluationFindings:
    """What `score` found, by forecaster.

    Attributes
    ----------
    windows : dict of str to WindowScores
        Open loop.
    closed_loop : dict of str to ClosedLoopScores
        Closed loop.
    pairs : tuple of Pair
        Each two of them; empty without point clouds.
    breakdown : dict of str to dict of str to Group
        By object, task, outcome and contact phase.
    by_episode : tuple of EpisodeScores
        One an episode.
    tracks : tuple of Track
        A few episodes for the figures.
    rows, gap_rows : int
        Rows scored in closed loop, and rows within the episodes that are marked as missing.
    begins_after : int
        Rows that each loop is shown before it begins.
    """

    windows: dict[str, WindowScores]
    closed_loop: dict[str, ClosedLoopScores]
    pairs: tuple[Pair, ...]
    breakdown: dict[str, dict[str, Group]]
    by_episode: tuple[EpisodeScores, ...]
    tracks: tuple[Track, ...]
    rows: int
    gap_rows: int
    begins_after: int


def score(
    windows: Windows,
    entrants: Mapping[str, Entrant],
    seed: int,
    stage: Callable[[str], None] = lambda _name: None,
    joints: Callable[[Course], NDArray] | None = None,
) -> EvaluationFindings:
    """Return the scores of all entrants on the same windows, and on the same episodes at the same instants.

    Parameters
    ----------
    windows : Windows
        Held-out windows with every channel that scores or entrants read; a row counts where all of them are valid.
    entrants : mapping of str to Entrant
        By name; the first of them decides which episodes are drawn.
    seed : int
        Seed of the noise and of the resampling.
    stage : callable
        Called with what is being done.
    joints : callable, optional
        From a course to the joints `(E, N, J)` that the closed loops feed; None replays the recorded ones.
    """
    clouds = _clouds(windows)
    window_results, increment_mse = {}, {}
    for name, entrant in entrants.items():
        stage(f"{name}: {len(chosen_windows(entrant.windows))} windows")
        window_results[name], increment_mse[name] = window_scores(entrant.windows, entrant.forecaster, clouds, seed)
    rows_before = max(entrant.windows.history for entrant in entrants.values())
    reference, errors = course(windows, rows_before), {}
    fed_joints = None if joints is None else joints(reference)
    for name, entrant in entrants.items():
        stage(f"{name}: {len(reference.episodes)} episodes in closed loop")
        loop = close_loop(_course(entrant, rows_before, fed_joints), entrant.forecaster, entrant.execute, seed)
        errors[name] = loop_errors(reference, loop, clouds)
    loop_results, pairs = _closed_loops(reference, errors, seed)
    inside = np.arange(1, reference.valid.shape[1] + 1) <= reference.steps[:, None]
    return EvaluationFindings(
        windows=window_results,
        closed_loop=loop_results,
        pairs=pairs,
        breakdown=breakdown(windows.dataset, reference, errors),
        by_episode=_by_episode(reference, errors, increment_mse),
        tracks=_tracks(reference, errors, entrants, rows_before, fed_joints, seed),
        rows=int(reference.valid.sum()),
        gap_rows=int((inside & ~reference.valid).sum()),
        begins_after=rows_before,
    )


def _course(entrant: Entrant, rows_before: int, fed_joints: NDArray | None) -> Course:
    """Return the course as an entrant sees it."""
    return replace(course(entrant.windows, rows_before), joints=fed_joints)


def _closed_loops(
    course: Course, errors: Mapping[str, LoopErrors], seed: int
) -> tuple[dict[str, ClosedLoopScores], tuple[Pair, ...]]:
    """Return the closed-loop scores by forecaster, and their differences in pairs where there is ADD-S."""
    scores = {name: closed_loop_scores(course, each) for name, each in errors.items()}
    if any(each.adds is None for each in errors.values()):
        return scores, ()
    areas = resampled_areas({name: area(course, each) for name, each in errors.items()}, course.valid.sum(1), seed)
    with_interval = {
        name: each.model_copy(update={"adds_auc_interval": areas.interval(name)}) for name, each in scores.items()
    }
    return with_interval, areas.pairs()


def _tracks(
    reference: Course,
    errors: Mapping[str, LoopErrors],
    entrants: Mapping[str, Entrant],
    rows_before: int,
    fed_joints: NDArray | None,
    seed: int,
) -> tuple[Track, ...]:
    """Return a few episodes; the best model that draws samples has them followed in some of them."""
    shown = tracks.find_tracks(reference, errors)
    drawn = {name: entrant.one_sample for name, entrant in entrants.items() if entrant.one_sample is not None}
    if not drawn:
        return shown
    name = min(drawn, key=lambda each: float(errors[each].position[reference.valid].mean()))
    seen = _course(entrants[name], rows_before, fed_joints)
    return tracks.with_samples(shown, name, drawn[name], seen, entrants[name].execute, seed)


def _clouds(windows: Windows) -> NDArray | None:
    """Return the clouds; None where an episode scored lacks its own: means are over all or nothing."""
    names = windows.cache.file.clouds
    return windows.clouds if all(names[e] for e in np.unique(windows.owner)) else None


def window_scores(
    windows: Windows, forecaster: Forecaster, clouds: NDArray | None, seed: int
) -> tuple[WindowScores, dict[int, float]]:
    """Return the open-loop scores of a forecaster, and the mean squared error of its increments by episode.

    Steps that are not in the recording count in none; an episode without any is left out.
    """
    batch = windows.batch(chosen_windows(windows))
    truth, valid = batch["future/object_pose"].astype(np.float64), ~batch["future_pad"]
    forecast = forecaster.forecast(batch, (seed,))
    begin = batch["history/object_pose"][:, -1]
    samples = integrate(begin, forecast.increments)
    mean = mean_pose(samples)
    distance, angle = position_error(mean, truth), rotation_error(mean, truth)
    energy = metrics.energy_score(samples[..., :3], truth[..., :3])
    adds = metrics.adds_of(clouds, batch["cloud"], mean, truth) if clouds is not None else None
    squares = _increment_squares(forecast.increments, begin, truth, valid)
    scores = WindowScores(
        position_error_m=_by_step(distance, valid),
        rotation_error_rad=_by_step(angle, valid),
        position_mse_m2=_by_step(distance**2, valid),
        rotation_mse_rad2=_by_step(angle**2, valid),
        increment_mse=float(np.nanmean(squares)) if np.isfinite(squares).any() else None,
        position_energy_m=_by_step(energy, valid),
        adds_m=_by_step(adds, valid) if adds is not None else (None,) * valid.shape[1],
        adds_auc=metrics.auc(adds[valid]) if adds is not None else None,
        contact=contact_scores(forecast.contact, batch.get("future/contact"), valid),
    )
    episodes = batch["episode"]
    parts = {int(episode): squares[episodes == episode] for episode in np.unique(episodes)}
    return scores, {e: float(np.nanmean(part)) for e, part in parts.items() if np.isfinite(part).any()}


def _increment_squares(forecast: NDArray, begin: NDArray, truth: NDArray, valid: NDArray[np.bool_]) -> NDArray:
    """Return `(B, H)` the mean square of the six errors of the samples' mean increment.

    NaN for a step that is not real on both sides.
    """
    recorded = increments(np.concatenate([begin[:, None].astype(np.float64), truth], axis=1))
    is_real = valid & np.concatenate([np.ones((len(valid), 1), bool), valid[:, :-1]], axis=1)
    squares = (np.asarray(forecast, np.float64).mean(axis=0) - recorded) ** 2
    return np.where(is_real, squares.mean(axis=-1), np.nan)


def chosen_windows(windows: Windows) -> NDArray[np.int64]:
    """Return the numbers of the windows that are forecast."""
    count = min(len(windows), MOST_WINDOWS)
    return np.linspace(0, len(windows) - 1, count).round().astype(np.int64)


def _by_step(values: NDArray, valid: NDArray[np.bool_]) -> tuple[float | None, ...]:
    """Return the means over the windows, by step; None where no window has the step."""
    columns = zip(values.T, valid.T, strict=True)
    return tuple(float(value[is_valid].mean()) if is_valid.any() else None for value, is_valid in columns)


def _by_episode(
    course: Course, errors: Mapping[str, LoopErrors], increment_mse: Mapping[str, Mapping[int, float]]
) -> tuple[EpisodeScores, ...]:
    """Return the scores of each episode."""
    moved_m = position_error(course.truth, course.observed[:, -1:])
    largest_m = np.where(course.valid, moved_m, 0.0).max(axis=1, initial=0.0)
    counts = course.valid.sum(axis=1)
    aucs = {n: area(course, each) / counts for n, each in errors.items() if each.adds is not None}
    final_m = {n: final_position_error(course, each) for n, each in errors.items()}
    return tuple(
        EpisodeScores(
            id=course.windows.episode_ids[episode],
            moved_m=float(largest_m[k]),
            adds_auc={name: float(values[k]) for name, values in aucs.items()},
            final_position_error_m={name: float(values[k]) for name, values in final_m.items()},
            increment_mse={name: values[episode] for name, values in increment_mse.items() if episode in values},
        )
        for k, episode in enumerate(course.episodes.tolist())
    )
