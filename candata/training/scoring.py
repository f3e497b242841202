"""Evaluation: per window and in closed loop, a model beside the baselines through the same code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from candata.loaders import Windows
from candata.loaders.increments import integrate
from candata.statistics import resamples
from candata.training import metrics
from candata.training.forecasters import Forecaster
from candata.training.poses import mean_pose, position_error, rotation_error
from candata.training.results import (
    ClosedLoopScores,
    Contact,
    EpisodeScores,
    Gain,
    Success,
    Track,
    WindowScores,
)
from candata.training.rollout import CONTACT_THRESHOLD, Course, Loop, close_loop, course, evenly_ranked

#: Resamples of the episodes for the interval of a gain.
RESAMPLES = 2000
#: Episodes below which resampling them says nothing of how another draw would come out, as in a diagnosis.
LEAST_EPISODES = 8
#: Windows that are forecast at most; of more, as many are taken, evenly spread.
MOST_WINDOWS = 4096
#: Episodes whose courses the page draws.
TRACKS = 4


@dataclass(frozen=True)
class EvaluationFindings:
    """What `score` found, by forecaster; the first one is the model.

    Attributes
    ----------
    windows : dict of str to WindowScores
        Open loop.
    closed_loop : dict of str to ClosedLoopScores
        Closed loop.
    gain : dict of str to Gain
        By baseline.
    by_episode : tuple of EpisodeScores
        One an episode.
    tracks : tuple of Track
        A few episodes for the figures.
    rows : int
        Rows scored in closed loop.
    """

    windows: dict[str, WindowScores]
    closed_loop: dict[str, ClosedLoopScores]
    gain: dict[str, Gain]
    by_episode: tuple[EpisodeScores, ...]
    tracks: tuple[Track, ...]
    rows: int


@dataclass(frozen=True)
class _Errors:
    """Errors of a closed loop, `(E, N)`; ADD-S is None without point clouds."""

    position: NDArray
    rotation: NDArray
    adds: NDArray | None
    loop: Loop = field(repr=False)


def score(
    windows: Windows,
    forecasters: Mapping[str, Forecaster],
    execute: int,
    seed: int,
    stage: Callable[[str], None] = lambda _name: None,
) -> EvaluationFindings:
    """Return the scores of all forecasters on the same windows and the same episodes.

    Parameters
    ----------
    windows : Windows
        Held-out windows.
    forecasters : mapping of str to Forecaster
        The model first, then what it is compared with.
    execute : int
        Steps executed before the next forecast in closed loop.
    seed : int
        Seed of the noise and of the resampling.
    stage : callable
        Called with what is being done.
    """
    clouds = _clouds(windows)
    window_results = {}
    for name, forecaster in forecasters.items():
        stage(f"{name}: {len(chosen_windows(windows))} windows")
        window_results[name] = window_scores(windows, forecaster, clouds, seed)
    course_all = course(windows)
    errors = {}
    for name, forecaster in forecasters.items():
        stage(f"{name}: {len(course_all.episodes)} episodes in closed loop")
        errors[name] = _errors(course_all, close_loop(course_all, forecaster, execute, seed), clouds)
    model, *other_names = forecasters
    return EvaluationFindings(
        windows=window_results,
        closed_loop={name: _closed_loop_scores(course_all, loop_errors) for name, loop_errors in errors.items()},
        gain={
            name: _auc_gain(course_all, errors[model], errors[name], seed) for name in other_names if clouds is not None
        },
        by_episode=tuple(_by_episode(course_all, errors, e) for e in range(len(course_all.episodes))),
        tracks=_tracks(course_all, errors, model),
        rows=int(course_all.valid.sum()),
    )


def _clouds(windows: Windows) -> NDArray | None:
    """Return the clouds; None where an episode scored lacks its own: means are over all or nothing."""
    names = windows.cache.file.clouds
    return windows.clouds if all(names[e] for e in np.unique(windows.owner)) else None


def window_scores(windows: Windows, forecaster: Forecaster, clouds: NDArray | None, seed: int) -> WindowScores:
    """Return the open-loop scores of a forecaster; steps that are not in the recording count in none."""
    batch = windows.batch(chosen_windows(windows))
    truth, valid = batch["future/object_pose"].astype(np.float64), ~batch["future_pad"]
    forecast = forecaster.forecast(batch, (seed,))
    samples = integrate(batch["history/object_pose"][:, -1], forecast.increments)
    mean = mean_pose(samples)
    distance, angle = position_error(mean, truth), rotation_error(mean, truth)
    energy = metrics.energy_score(samples[..., :3], truth[..., :3])
    adds = metrics.adds_of(clouds, batch["cloud"], mean, truth) if clouds is not None else None
    return WindowScores(
        position_error_m=_by_step(distance, valid),
        rotation_error_rad=_by_step(angle, valid),
        position_mse_m2=_by_step(distance**2, valid),
        rotation_mse_rad2=_by_step(angle**2, valid),
        position_energy_m=_by_step(energy, valid),
        adds_m=_by_step(adds, valid) if adds is not None else (None,) * valid.shape[1],
        adds_auc=metrics.auc(adds[valid]) if adds is not None else None,
        contact=_contact(forecast.contact, batch.get("future/contact"), valid),
    )


def chosen_windows(windows: Windows) -> NDArray[np.int64]:
    """Return the numbers of the windows that are forecast."""
    count = min(len(windows), MOST_WINDOWS)
    return np.linspace(0, len(windows) - 1, count).round().astype(np.int64)


def _by_step(values: NDArray, valid: NDArray[np.bool_]) -> tuple[float | None, ...]:
    """Return the means over the windows, by step; None where no window has the step."""
    columns = zip(values.T, valid.T, strict=True)
    return tuple(float(value[is_valid].mean()) if is_valid.any() else None for value, is_valid in columns)


def _contact(forecast: NDArray | None, truth: NDArray | None, valid: NDArray[np.bool_]) -> Contact | None:
    """Return how well contact was forecast; None where it was not, or is not recorded."""
    if forecast is None or truth is None:
        return None
    return Contact.model_validate(metrics.f1(forecast[valid] >= CONTACT_THRESHOLD, truth[valid]))


def _errors(course: Course, loop: Loop, clouds: NDArray | None) -> _Errors:
    """Return the errors of a loop at each row."""
    adds = metrics.adds_of(clouds, course.cloud, loop.poses, course.truth) if clouds is not None else None
    return _Errors(position_error(loop.poses, course.truth), rotation_error(loop.poses, course.truth), adds, loop)


def _closed_loop_scores(course: Course, errors: _Errors) -> ClosedLoopScores:
    """Return the closed-loop scores of a forecaster."""
    is_valid, final = course.valid, _final(course, errors.position)
    truth = None if course.contact is None else course.contact[:, course.observed.shape[1] :]
    count, total = int((final <= metrics.SUCCESS_M).sum()), len(final)
    low, high = map(float, binomtest(count, total).proportion_ci(0.95, "wilson"))
    return ClosedLoopScores(
        adds_auc=metrics.auc(errors.adds[is_valid]) if errors.adds is not None else None,
        adds_m=float(errors.adds[is_valid].mean()) if errors.adds is not None else None,
        position_error_m=float(errors.position[is_valid].mean()),
        rotation_error_rad=float(errors.rotation[is_valid].mean()),
        final_position_error_m=float(final.mean()),
        success=Success(count=count, total=total, share=count / total, low=low, high=high),
        contact=_contact(errors.loop.contact, truth, is_valid),
    )


def _final(course: Course, position: NDArray) -> NDArray:
    """Return the error `(E,) [m]` at each episode's last row that counts."""
    last_rows = course.valid.shape[1] - 1 - np.argmax(course.valid[:, ::-1], axis=1)
    return position[np.arange(len(last_rows)), last_rows]


def _auc_gain(course: Course, model: _Errors, reference: _Errors, seed: int) -> Gain:
    """Return by how much the model's AUC exceeds another's; the interval resamples whole episodes, in pairs."""
    sums = np.array([_area(course, errors).sum(1) for errors in (model, reference)])
    counts = course.valid.sum(1)
    value = float((sums[0] - sums[1]).sum() / counts.sum())
    if len(counts) < LEAST_EPISODES:
        return Gain(value=value, low=None, high=None)
    picks = resamples(np.random.default_rng([seed, 3]), len(counts), RESAMPLES)
    gains = (sums[0] - sums[1])[picks].sum(1) / counts[picks].sum(1)
    low, high = np.quantile(gains, (0.025, 0.975))
    return Gain(value=value, low=float(low), high=float(high))


def _area(course: Course, errors: _Errors) -> NDArray:
    """Return each row's part `(E, N)` of the area under the curve; 0 for rows that do not count."""
    adds = np.zeros(course.valid.shape) if errors.adds is None else errors.adds
    return np.where(course.valid, np.maximum(0.0, 1 - adds / metrics.ADDS_LIMIT_M), 0.0)


def _by_episode(course: Course, errors: Mapping[str, _Errors], number: int) -> EpisodeScores:
    """Return the scores of one episode."""
    is_valid = course.valid[number]
    moved_m = position_error(course.truth[number], course.observed[number, -1])
    return EpisodeScores(
        id=course.windows.episode_ids[course.episodes[number]],
        moved_m=float(moved_m[is_valid].max(initial=0.0)),
        adds_auc={n: metrics.auc(f.adds[number][is_valid]) for n, f in errors.items() if f.adds is not None},
        final_position_error_m={n: float(_final(course, f.position)[number]) for n, f in errors.items()},
    )


def _tracks(course: Course, errors: Mapping[str, _Errors], model: str) -> tuple[Track, ...]:
    """Return a few episodes, spread evenly from the model's worst to its best."""
    mean = np.where(course.valid, errors[model].position, 0).sum(1) / np.maximum(course.valid.sum(1), 1)
    return tuple(_track(course, errors, model, number) for number in evenly_ranked(-mean, TRACKS))


def _track(course: Course, errors: Mapping[str, _Errors], model: str, number: int) -> Track:
    """Return one episode, the row it begins with first."""
    count, history_rows = int(course.steps[number]), course.observed.shape[1]
    rows = slice(0, count)
    begin = course.observed[number, -1:]
    forecast = errors[model].loop.contact
    first_step = (
        course.windows.present_row[number] - course.windows.cache.begin[course.episodes[number]]
    ) // course.windows.stride[course.episodes[number]]
    return Track(
        id=course.windows.episode_ids[course.episodes[number]],
        time_s=(first_step + np.arange(count + 1)) / course.windows.rate_hz,
        truth=np.concatenate([begin, course.truth[number, rows]]),
        poses={
            name: np.concatenate([begin, loop_errors.loop.poses[number, rows]]) for name, loop_errors in errors.items()
        },
        contact=None if course.contact is None else course.contact[number, history_rows - 1 : history_rows + count],
        forecast_contact=None if forecast is None else np.concatenate([[np.nan], forecast[number, rows]]),
    )
