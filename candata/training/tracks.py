"""A few episodes of an evaluation in closed loop, for its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.training.forecasters import Forecaster
from candata.training.loop_errors import LoopErrors
from candata.training.results import Track
from candata.training.rollout import Course, close_loop, evenly_ranked, repeated

#: Episodes whose courses the page draws; those with sampled loops beside; samples followed.
TRACKS, SAMPLED_TRACKS, SAMPLED_LOOPS = 4, 2, 8


def find_tracks(course: Course, errors: Mapping[str, LoopErrors]) -> tuple[Track, ...]:
    """Return a few episodes, spread evenly from the first forecaster's worst to its best."""
    position = next(iter(errors.values())).position
    mean = np.where(course.valid, position, 0).sum(1) / np.maximum(course.valid.sum(1), 1)
    return tuple(_track(course, errors, number) for number in evenly_ranked(-mean, TRACKS))


def _track(course: Course, errors: Mapping[str, LoopErrors], number: int) -> Track:
    """Return one episode, the row it begins with first."""
    count, history_rows = int(course.steps[number]), course.observed.shape[1]
    rows, begin = slice(0, count), course.observed[number, -1:]
    first_step = (
        course.windows.present_row[number] - course.windows.cache.begin[course.episodes[number]]
    ) // course.windows.stride[course.episodes[number]]
    return Track(
        id=course.windows.episode_ids[course.episodes[number]],
        time_s=(first_step + np.arange(count + 1)) / course.windows.rate_hz,
        truth=np.concatenate([begin, course.truth[number, rows]]),
        poses={name: np.concatenate([begin, each.loop.poses[number, rows]]) for name, each in errors.items()},
        contact=None if course.contact is None else course.contact[number, history_rows - 1 : history_rows + count],
        forecast_contact={
            name: np.concatenate([[np.nan], each.loop.contact[number, rows]])
            for name, each in errors.items()
            if each.loop.contact is not None
        },
    )


def with_samples(
    tracks: tuple[Track, ...], name: str, one_sample: Forecaster, course: Course, execute: int, seed: int
) -> tuple[Track, ...]:
    """Return the tracks, the first and the last of them with closed loops that each follow one sample of a model.

    Parameters
    ----------
    tracks : tuple of Track
    name : str
        Under which the model is known.
    one_sample : Forecaster
        The model with one sample a forecast.
    course : Course
        As the model sees it.
    execute, seed : int
        Steps executed before the next forecast, seed of the noise.
    """
    numbers = {course.windows.episode_ids[e]: k for k, e in enumerate(course.episodes.tolist())}
    chosen = sorted({0, len(tracks) - 1})[:SAMPLED_TRACKS]
    places = np.repeat([numbers[tracks[k].id] for k in chosen], SAMPLED_LOOPS)
    loop = close_loop(repeated(course, places), one_sample, execute, seed)
    poses = loop.poses.reshape(len(chosen), SAMPLED_LOOPS, *loop.poses.shape[1:])
    result = list(tracks)
    for k, sampled in zip(chosen, poses, strict=True):
        result[k] = replace(tracks[k], sampled={name: _with_begin(tracks[k].truth, sampled)})
    return tuple(result)


def _with_begin(truth: NDArray, sampled: NDArray) -> NDArray:
    """Return loops `(M, T, 7)` of an episode of `T` rows, the row they begin with first."""
    begin = np.broadcast_to(truth[:1], (len(sampled), 1, 7))
    return np.concatenate([begin, sampled[:, : len(truth) - 1]], axis=1)
