"""What a run is: its settings, the facts that its checkpoints name, and how far it has come."""

from __future__ import annotations

import math
from typing import Any, Self

from pydantic import Field, model_validator

from candata.loaders import Augmentation
from candata.schema.effect import EffectSetting
from candata.schema.record import Record, ResultRecord

#: Rate of a fine-tuning run as a share of a fresh one's.
FINE_TUNE_SHARE = 0.1
#: Warm-up never takes more than this share of a short run.
WARM_UP_SHARE = 0.1


class TrainingSettings(Record):
    """How to train; equal settings on equal data give equal weights (on one CPU and one number of threads).

    Source: the defaults of optimiser, warm-up, decay and average are those of C. Chi et al., "Diffusion Policy",
    RSS 2023, published code.

    Attributes
    ----------
    seed : int
        Of the first weights, the order of the data and the noise.
    batch : int
        Windows a step.
    steps : int or None
        Length of the run in steps.
    minutes : float or None
        Length of the run in minutes instead; how many steps that is depends on the machine.
    learning_rate, betas, weight_decay : float
        Of AdamW.
    warm_up : int
        Steps of linear warm-up; then a cosine decay to zero at the end of the run.
    ema_power : float
        Of the weights' moving average.
    clip_norm : float
        Largest norm of a gradient.
    validate_every : int
        Steps between validations, each of which saves.
    save_every_s : float
        Longest time between saves [s].
    log_every : int
        Steps a line of the log.
    bad_limit : int
        Steps in a row without a finite loss and gradient that end the run.
    augment : Augmentation
        Noise on poses and commands of the batches trained on; none by default.
    """

    seed: int = Field(0, ge=0, lt=2**64)
    batch: int = Field(64, ge=1)
    steps: int | None = Field(20_000, ge=1)
    minutes: float | None = Field(None, gt=0)
    learning_rate: float = Field(1e-4, gt=0)
    betas: tuple[float, float] = (0.95, 0.999)
    weight_decay: float = Field(1e-6, ge=0)
    warm_up: int = Field(500, ge=0)
    ema_power: float = Field(0.75, gt=0)
    clip_norm: float = Field(1.0, gt=0)
    validate_every: int = Field(500, ge=1)
    save_every_s: float = Field(60.0, ge=0)
    log_every: int = Field(10, ge=1)
    bad_limit: int = Field(20, ge=1)
    augment: Augmentation = Augmentation()

    @model_validator(mode="after")
    def _ends(self) -> Self:
        """Return the settings; a run must end."""
        if self.steps is None and self.minutes is None:
            raise ValueError("a run needs a length: steps or minutes")
        return self

    def share(self, step: int, elapsed_s: float) -> float:
        """Return the share of the run that is done, 0 to 1."""
        by_steps = step / self.steps if self.steps else 0.0
        by_time = elapsed_s / (60 * self.minutes) if self.minutes else 0.0
        return min(1.0, max(by_steps, by_time))

    def rate(self, step: int, elapsed_s: float) -> float:
        """Return the learning rate of a step: linear warm-up times cosine decay."""
        share = self.share(step, elapsed_s)
        warm_up_factor = min(1.0, max((step + 1) / max(self.warm_up, 1), share / WARM_UP_SHARE))
        return self.learning_rate * warm_up_factor * 0.5 * (1 + math.cos(math.pi * share))


class TrainingSource(Record):
    """One of the datasets trained on: its share of the windows, version, and who of it trained."""

    name: str
    share: float
    dataset: str
    digest: str
    version: int
    split_digest: str


class RunSimulator(Record):
    """The simulator whose forecasts a model reads.

    Attributes
    ----------
    scene : str or None
        What `load_scene` takes; None for the scene that each episode names.
    effects : tuple of EffectSetting
        Effects that act in every scene.
    digests : dict of str to str
        SHA-256 of each scene trained with, effects included.
    """

    scene: str | None = None
    effects: tuple[EffectSetting, ...] = ()
    digests: dict[str, str] = Field(default_factory=dict)


class Run(Record):
    """`run.json`, and the head of every checkpoint: all that decides what the weights mean.

    Attributes
    ----------
    model, preset, config : str, str or None, dict
        Model, the preset it came from, and its configuration as plain values.
    sizes : dict of str to int
        As in `candata.models.Sizes`.
    joint_names, actuator_names, fingertip_names : tuple of str
        What the elements of the channels are.
    dataset, digest, version : str, str, int
        Data trained on. Of a mixture: its text, the hash of its sources, and 0.
    split, split_digest : str
        Name of the split whose `train` was trained on, and the hash of who is in it.
    sources : tuple of Source
        Of a mixture: its datasets; empty for one dataset.
    rate_hz : float
        Rate at which the model steps.
    channels : tuple of str
        What it reads.
    units : dict of str to str
        Unit of each channel, as it is fed and forecast.
    normaliser : dict
        Centre and scale of each channel.
    settings : TrainingSettings
        How it was trained.
    init : dict or None
        For a fine-tuned model: dataset, digest and step of the checkpoint it began with, and all ids it had been
        trained on by then (null where unknown).
    simulator : RunSimulator or None
        Whose forecasts the model reads; None for a model that reads none.
    revision : str
        Version of candata.
    """

    format: str = "candata-run-1"
    model: str
    preset: str | None = None
    config: dict[str, Any]
    sizes: dict[str, int]
    joint_names: tuple[str, ...] = ()
    actuator_names: tuple[str, ...] = ()
    fingertip_names: tuple[str, ...] = ()
    dataset: str
    digest: str
    version: int
    split: str
    split_digest: str
    sources: tuple[TrainingSource, ...] = ()
    rate_hz: float
    channels: tuple[str, ...]
    units: dict[str, str]
    normaliser: dict[str, Any]
    settings: TrainingSettings
    init: dict[str, Any] | None = None
    simulator: RunSimulator | None = None
    revision: str

    @property
    def planned_actions(self) -> bool | None:
        """Whether the model reads the actions that will be taken; None where its configuration does not say."""
        return self.config.get("planned_actions")

    @property
    def trained_on(self) -> tuple[TrainingSource, ...]:
        """The datasets trained on, one or those of the mixture."""
        dataset_fields = {name: getattr(self, name) for name in ("dataset", "digest", "version", "split_digest")}
        return self.sources or (TrainingSource(name=self.dataset, share=1.0, **dataset_fields),)


class Progress(ResultRecord):
    """How far a run has come.

    Attributes
    ----------
    step : int
        Steps done, skipped ones included.
    elapsed_s : float
        Time spent on them.
    skipped, bad_in_row : int
        Steps without a finite loss and gradient, all and just now.
    best_loss, best_step : float, int or None
        Least validation loss and its step.
    """

    step: int = 0
    elapsed_s: float = 0.0
    skipped: int = 0
    bad_in_row: int = 0
    best_loss: float | None = None
    best_step: int | None = None
