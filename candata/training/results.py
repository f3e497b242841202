"""What an evaluation found: `evaluation.json`, units in the names."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from candata.schema.effect import EffectSetting
from candata.schema.record import ResultRecord

if TYPE_CHECKING:
    from candata.scenes import Scene

Interval = tuple[float, float]
#: Rows of the simulators: nominal, and with the effects of a repair.
SIMULATOR, REPAIRED = "simulator", "repaired simulator"


class Contact(ResultRecord):
    """Forecast contact against recorded contact, over all steps; null where nothing can be said.

    Attributes
    ----------
    precision, recall, f1 : float or None
        Shares, 0 to 1, of a forecast that counts as contact from a probability of 0.5 on.
    auroc : float or None
        Probability that a step in contact is given a higher probability than one without; 0.5 is a guess.
    """

    precision: float | None
    recall: float | None
    f1: float | None
    auroc: float | None


class EventTiming(ResultRecord):
    """When contacts begin, or end, in closed loop, against the recording.

    Attributes
    ----------
    recorded, matched, spurious : int
        Recorded events; those that a forecast event answers to; forecast events that answer to none.
    median_s, q25_s, q75_s : float or None
        Forecast time less recorded time of the matched ones: quartiles. Negative is early.
    """

    recorded: int
    matched: int
    spurious: int
    median_s: float | None
    q25_s: float | None
    q75_s: float | None


class WindowScores(ResultRecord):
    """One forecast of the whole horizon from each window; the mean of the samples is scored.

    Attributes
    ----------
    position_error_m, rotation_error_rad : tuple of float or None
        Mean distance and angle, by step of the horizon; null for a step that no window holds.
    position_mse_m2, rotation_mse_rad2 : tuple of float or None
        Means of their squares, by step.
    increment_mse : float or None
        Mean over windows, steps and the six numbers of a pose increment (three in m, three in rad) of the squared
        error: units mixed, for a look beside the MSE of arXiv 2601.12796, which states no unit.
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
    increment_mse: float | None
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


class LongLoopScores(ResultRecord):
    """A closed loop some time after it began, over the episodes that are so long.

    Attributes
    ----------
    time_s : float
        Time since the loop began.
    episodes : int
        Episodes whose pose is recorded then; the rest is null where there is none.
    position_error_m, rotation_error_rad, adds_m : float or None
        Mean errors at that time.
    adds_auc : float or None
        Area under the accuracy curve of ADD-S over all rows up to that time.
    """

    time_s: float
    episodes: int
    position_error_m: float | None
    rotation_error_rad: float | None
    adds_m: float | None
    adds_auc: float | None


class ClosedLoopScores(ResultRecord):
    """Whole episodes: the forecaster's own poses are fed back.

    Attributes
    ----------
    adds_auc : float or None
        Area under the accuracy curve of ADD-S up to 0.1 m, over all rows; null without point clouds.
    adds_auc_interval : (float, float) or None
        Its 95 % interval over resampled episodes; null for fewer than 8.
    adds_m, position_error_m, rotation_error_rad : float
        Means over all rows.
    final_position_error_m : float
        Mean over the episodes' last rows.
    success : Success
        By the final position.
    contact : Contact or None
        For a forecaster that says when the hand touches.
    onset, release : EventTiming or None
        When contacts begin and end, for such a forecaster.
    long_loops : tuple of LongLoopScores
        2, 5 and 10 s after the loop began.
    """

    adds_auc: float | None
    adds_auc_interval: Interval | None = None
    adds_m: float | None
    position_error_m: float
    rotation_error_rad: float
    final_position_error_m: float
    success: Success
    contact: Contact | None
    onset: EventTiming | None = None
    release: EventTiming | None = None
    long_loops: tuple[LongLoopScores, ...] = ()


class Scores(ResultRecord):
    """All of one forecaster."""

    summary: str
    windows: WindowScores
    closed_loop: ClosedLoopScores


class Pair(ResultRecord):
    """Closed-loop ADD-S AUC of a forecaster less that of a reference; 95 % interval over resampled episodes.

    Both are resampled by the same draws. The interval is null for fewer than 8 episodes.
    """

    forecaster: str
    reference: str
    value: float
    low: float | None
    high: float | None

    def reversed(self) -> Pair:
        """Return the pair seen from the reference."""
        low, high = (None if end is None else -end for end in (self.high, self.low))
        return Pair(forecaster=self.reference, reference=self.forecaster, value=-self.value, low=low, high=high)


class GroupScores(ResultRecord):
    """Closed-loop scores of one forecaster over the rows of a group."""

    adds_auc: float | None
    adds_m: float | None
    position_error_m: float
    rotation_error_rad: float


class Group(ResultRecord):
    """Rows in closed loop that have something in common: how many, of how many episodes, and scores by forecaster."""

    episodes: int
    rows: int
    scores: dict[str, GroupScores]


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
    increment_mse : dict of str to float
        By forecaster, over the windows of the episode; see `WindowScores`.
    """

    id: str
    moved_m: float
    adds_auc: dict[str, float]
    final_position_error_m: dict[str, float]
    increment_mse: dict[str, float] = Field(default_factory=dict)


class SimulatorFacts(ResultRecord):
    """What a simulator is: the scene (null: each episode's own), and the effects added to it."""

    scene: str | None
    effects: tuple[EffectSetting, ...] = ()


class ModelFacts(ResultRecord):
    """What was evaluated under a model's name.

    Attributes
    ----------
    run, checkpoint, step : str, str, int
        Folder of the run, file and step of the checkpoint.
    model, preset, trained_on : str, str or None, str
        Name of the model and of the preset it came from; dataset@digest it was trained on.
    planned_actions : bool or None
        Whether it is told the commands of the coming steps; null for a model that cannot be.
    seen_episodes : int or None
        Episodes evaluated on that it was trained on; 0 in an honest evaluation, null where not known.
    history, horizon : int
        Its rows of the past and steps of the future.
    execute : int
        Steps executed before the next forecast in closed loop.
    simulator : SimulatorFacts or None
        The simulator whose forecasts it reads.
    contact_from : str
        What the closed loop feeds it as contact: `recorded`, `predicted`, `not read`, or `predicted, fingertips
        recorded`.
    """

    run: str
    checkpoint: str
    step: int
    model: str
    preset: str | None
    trained_on: str
    planned_actions: bool | None
    seen_episodes: int | None
    history: int
    horizon: int
    execute: int
    simulator: SimulatorFacts | None = None
    contact_from: str


class Evaluation(ResultRecord):
    """Models, simulators and baselines on the same held-out episodes.

    Attributes
    ----------
    dataset, split, group : str
        dataset@digest evaluated on; the split's name and the group of it.
    episodes, windows, rows : int
        How many were scored; rows in closed loop.
    gap_rows : int
        Rows of the closed loops that are marked as missing, or lie beyond a break of the clock: they count nowhere.
    rate_hz : float
        Steps of all models.
    begins_after : int
        Rows that each closed loop is shown before it begins, the longest history of the models.
    samples, sampling_steps, seed : int
        Samples averaged, steps of a sampler, seed of the noise.
    joints_from, actions_from : str
        What the closed loop feeds the models: joints `recorded`, by a `servo` lag fitted on training episodes, or of
        the simulator so named; actions `recorded`. A simulator moves its own joints.
    models : dict of str to ModelFacts
        By name.
    simulators : dict of str to SimulatorFacts
        By name.
    forecasters : dict of str to Scores
        The models, the simulators, then the baselines.
    pairs : tuple of Pair
        Each two of them, in that order; empty without point clouds.
    breakdown : dict of str to dict of str to Group
        `object`, `task`, `outcome` and contact `phase`, where the recordings state them.
    by_episode : tuple of EpisodeScores
        One an episode.
    notes : tuple of str
        What a reader must know of this evaluation: what was left out, and why.
    revision : str
        Version of candata.
    """

    dataset: str
    split: str
    group: str
    episodes: int
    windows: int
    rows: int
    gap_rows: int
    rate_hz: float
    begins_after: int
    samples: int
    sampling_steps: int
    seed: int
    joints_from: str = "recorded"
    actions_from: str = "recorded"
    models: dict[str, ModelFacts]
    simulators: dict[str, SimulatorFacts] = Field(default_factory=dict)
    forecasters: dict[str, Scores]
    pairs: tuple[Pair, ...]
    breakdown: dict[str, dict[str, Group]] = Field(default_factory=dict)
    by_episode: tuple[EpisodeScores, ...]
    notes: tuple[str, ...] = ()
    revision: str

    def pair(self, forecaster: str, reference: str) -> Pair | None:
        """Return what a forecaster gains over another; None without point clouds, or of one by itself."""
        for pair in self.pairs:
            if (pair.forecaster, pair.reference) == (forecaster, reference):
                return pair
            if (pair.reference, pair.forecaster) == (forecaster, reference):
                return pair.reversed()
        return None


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
    forecast_contact : dict of str to (T,) float
        Probability of contact by the forecasters that say it; NaN at the first row.
    sampled : dict of str to (M, T, 7)
        Closed loops that each followed one sample of a model, by model; a few episodes have them.
    scene : Scene or None
        What the simulators simulate of it, without the effects; None without a simulator.
    """

    id: str
    time_s: NDArray[np.float64]
    truth: NDArray
    poses: dict[str, NDArray]
    contact: NDArray[np.bool_] | None
    forecast_contact: dict[str, NDArray]
    sampled: dict[str, NDArray] = field(default_factory=dict)
    scene: Scene | None = None
