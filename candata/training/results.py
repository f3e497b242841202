"""What an evaluation found: `evaluation.json`, units in the names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.schema.record import ResultRecord


class Contact(ResultRecord):
    """Forecast contact against recorded contact, over all steps; null where nothing can be said.

    Attributes
    ----------
    precision, recall, f1 : float or None
        Shares, 0 to 1.
    """

    precision: float | None
    recall: float | None
    f1: float | None


class WindowScores(ResultRecord):
    """One forecast of the whole horizon from each window; the mean of the samples is scored.

    Attributes
    ----------
    position_error_m, rotation_error_rad : tuple of float or None
        Mean distance and angle, by step of the horizon; null for a step that no window holds.
    position_mse_m2, rotation_mse_rad2 : tuple of float or None
        Means of their squares, by step.
    position_energy_m : tuple of float or None
        Energy score of the samples' positions, by step.
    adds_m : tuple of float or None
        Mean ADD-S, by step; null where an episode has no point cloud.
    adds_auc : float or None
        Area under the accuracy curve of ADD-S up to 0.1 m, over all steps.
    contact : Contact or None
        For a forecaster that says when the hand touches.
    """

    position_error_m: tuple[float | None, ...]
    rotation_error_rad: tuple[float | None, ...]
    position_mse_m2: tuple[float | None, ...]
    rotation_mse_rad2: tuple[float | None, ...]
    position_energy_m: tuple[float | None, ...]
    adds_m: tuple[float | None, ...]
    adds_auc: float | None
    contact: Contact | None


class Success(ResultRecord):
    """Episodes whose final position lies within 5 cm of the true one, with a 95 % Wilson interval."""

    count: int
    total: int
    share: float
    low: float
    high: float


class ClosedLoopScores(ResultRecord):
    """Whole episodes: the forecaster's own poses are fed back.

    Attributes
    ----------
    adds_auc : float or None
        Area under the accuracy curve of ADD-S up to 0.1 m, over all rows.
    adds_m, position_error_m, rotation_error_rad : float or None
        Means over all rows.
    final_position_error_m : float
        Mean over the episodes' last rows.
    success : Success
        By the last row's position.
    contact : Contact or None
        Contact as forecast in the loop.
    """

    adds_auc: float | None
    adds_m: float | None
    position_error_m: float
    rotation_error_rad: float
    final_position_error_m: float
    success: Success
    contact: Contact | None


class Scores(ResultRecord):
    """All of one forecaster."""

    summary: str
    windows: WindowScores
    closed_loop: ClosedLoopScores


class Gain(ResultRecord):
    """Closed-loop ADD-S AUC of the model less that of a baseline; 95 % interval over resampled episodes.

    The interval is null for fewer than 8 episodes.
    """

    value: float
    low: float | None
    high: float | None


class EpisodeScores(ResultRecord):
    """One episode in closed loop, by forecaster.

    Attributes
    ----------
    id : str
        Episode.
    moved_m : float
        Largest distance of the object from where the loop began.
    adds_auc : dict of str to float
        By forecaster; empty without a point cloud.
    final_position_error_m : dict of str to float
        By forecaster.
    """

    id: str
    moved_m: float
    adds_auc: dict[str, float]
    final_position_error_m: dict[str, float]


class Evaluation(ResultRecord):
    """A model beside the baselines on held-out episodes.

    Attributes
    ----------
    run, checkpoint, step : str, str, int
        Folder of the run, file and step of the checkpoint.
    model, trained_on : str
        Name of the model; dataset@digest it was trained on.
    dataset, split, group : str
        dataset@digest evaluated on; the split's name and the group of it.
    seen_episodes : int or None
        Episodes evaluated on that the model was trained on; 0 in an honest evaluation, null where not known.
    episodes, windows, rows : int
        How many were scored; rows in closed loop.
    rate_hz, history, horizon : float, int, int
        Steps of the model.
    samples, sampling_steps, execute, seed : int
        Samples averaged, steps of a sampler, steps executed before the next forecast, seed of the noise.
    joints_from, actions_from, contact_from : str
        What the closed loop feeds: `recorded`, `predicted` or `not read`; of contact also `predicted, fingertips
        recorded`.
    forecasters : dict of str to Scores
        The model under its name, then the baselines.
    gain : dict of str to Gain
        By baseline; empty without a point cloud.
    by_episode : tuple of EpisodeScores
        One an episode.
    revision : str
        Version of candata.
    """

    run: str
    checkpoint: str
    step: int
    model: str
    trained_on: str
    dataset: str
    split: str
    group: str
    seen_episodes: int | None
    episodes: int
    windows: int
    rows: int
    rate_hz: float
    history: int
    horizon: int
    samples: int
    sampling_steps: int
    execute: int
    seed: int
    joints_from: str = "recorded"
    actions_from: str = "recorded"
    contact_from: str
    forecasters: dict[str, Scores]
    gain: dict[str, Gain]
    by_episode: tuple[EpisodeScores, ...]
    revision: str


@dataclass(frozen=True)
class Track:
    """An episode in closed loop, for the figures.

    Attributes
    ----------
    id : str
        Episode.
    time_s : (T,) float64 [s]
        From the start of the episode; the first row is the last one observed.
    truth : (T, 7)
        Recorded poses [m, w x y z].
    poses : dict of str to (T, 7)
        By forecaster.
    contact : (T,) bool or None
        Recorded contact.
    forecast_contact : (T,) float or None
        The model's probability of contact; NaN at the first row.
    """

    id: str
    time_s: NDArray[np.float64]
    truth: NDArray
    poses: dict[str, NDArray]
    contact: NDArray[np.bool_] | None
    forecast_contact: NDArray | None
