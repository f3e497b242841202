"""How much of a learned correction is played: chosen in closed loop on validation episodes, none where none helps.

A correction is trained on windows that begin at recorded poses, and its errors add up where it is fed its own. The
gain scales it, so that a model over a simulator that is right already ends as the simulator.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from candata.loaders import Windows
from candata.models.sim_residual import SimResidual
from candata.training import feed
from candata.training.forecasters import TrainedModel
from candata.training.loop_errors import loop_errors
from candata.training.rollout import Course, close_loop, course, repeated
from candata.training.simulator import Simulator

#: Gains that are compared, the least first: none, some, half, and all of the correction. Chosen: quarters and halves
#: are as fine as a few validation episodes can tell apart.
GAINS = (0.0, 0.25, 0.5, 1.0)
#: Validation episodes that are followed, evenly spread, of each source. Chosen: a minute on one core.
EPISODES = 12
#: Samples of each forecast, and steps of the sampler. Chosen: their mean is within 0.1 points of AUC of 16 of 10 steps.
SAMPLES, STEPS = 4, 4


def least_near_best(errors: NDArray[np.float64]) -> int:
    """Return the row of the first of errors `(G, E)` whose mean is within one standard error of the least mean.

    A row with an error that is not finite is of a loop that diverged: it is neither the best nor near it.
    The standard error is that of the paired differences from the best row. Source: the one-standard-error rule of L.
    Breiman et al., "Classification and Regression Trees", 1984, section 3.4.3.
    """
    finite = np.asarray(np.isfinite(errors).all(1))
    known = np.where(finite[:, None], errors, 0.0)
    best = int(np.where(finite, known.mean(1), np.inf).argmin())
    differences = known - known[best]
    spread = differences.std(1, ddof=1) if errors.shape[1] > 1 else np.zeros(len(errors))
    return int(np.argmax(finite & (differences.mean(1) <= spread / np.sqrt(errors.shape[1]))))


def choose_gain(
    module: torch.nn.Module, followed: Sequence[tuple[Windows, Simulator]], execute: int, seed: int, device: str
) -> float:
    """Set the gain of a module's corrections, and return it.

    Parameters
    ----------
    module : torch.nn.Module
        Model with its weights, on `device`: `sim_residual`, or several as one.
    followed : sequence of (Windows, Simulator)
        Validation episodes of each source, and what the model reads for them.
    execute : int
        Steps executed before the next forecast.
    seed : int
        Seed of the samples.
    device : str
        `cpu` or `cuda`.

    Raises
    ------
    DataError
        When no episode has a valid pose after its first rows.
    """
    corrections = [part for part in module.modules() if isinstance(part, SimResidual)]
    courses = [_few(course(windows)) for windows, _simulator in followed]

    def errors(gain: float) -> NDArray[np.float64]:
        for part in corrections:
            part.gain.fill_(gain)
        forecasters = (
            TrainedModel(module, feed.clouds_of(windows, device), SAMPLES, STEPS, device, simulator=simulator)
            for windows, simulator in followed
        )
        parts = zip(courses, forecasters, strict=True)
        return np.concatenate([_episode_errors(each, forecaster, execute, seed) for each, forecaster in parts])

    chosen = GAINS[least_near_best(np.stack([errors(gain) for gain in GAINS]))]
    for part in corrections:
        part.gain.fill_(chosen)
    return chosen


def _few(whole: Course) -> Course:
    """Return the course of a few episodes, evenly spread."""
    count = len(whole.episodes)
    return repeated(whole, np.linspace(0, count - 1, min(EPISODES, count)).round().astype(np.int64))


def _episode_errors(followed: Course, forecaster: TrainedModel, execute: int, seed: int) -> NDArray[np.float64]:
    """Return the mean error `(E,) [m]` of each episode in closed loop: ADD-S, of the position without point clouds."""
    clouds = followed.windows.clouds
    has_clouds = bool(clouds.shape[1]) and bool((followed.cloud >= 0).all())
    errors = loop_errors(followed, close_loop(followed, forecaster, execute, seed), clouds if has_clouds else None)
    error = errors.position if errors.adds is None else errors.adds
    return np.asarray(np.where(followed.valid, error, 0.0).sum(1) / followed.valid.sum(1))
