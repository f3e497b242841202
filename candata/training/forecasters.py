"""Who forecasts: the plain baselines, and a trained model; all answer the same question."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from candata.loaders.increments import increments

if TYPE_CHECKING:
    import torch

Batch = Mapping[str, NDArray]

#: Entry of a batch whose joints are those that a closed loop feeds, not the recorded ones: `(B,) bool`.
JOINTS_FED = "joints_fed"
#: Entry of a batch whose planned commands are not the recorded ones: `(B, R, A) float64` at the episodes' own rate, the
#: first held from the present on; the last holds on.
COMMANDS_PLANNED = "planned_rows/action"
#: Entry of a batch whose windows each draw from a stream of their own, by its number: `(B,) int64`.
NOISE_NUMBERS = "noise_numbers"
#: Windows that a model forecasts at once.
_AT_ONCE = 256


@dataclass(frozen=True)
class ForecastArrays:
    """Forecasts of B windows.

    Attributes
    ----------
    increments : (M, B, H, 6) float [m, rad]
        Pose increments as in `candata.models.Forecast`.
    contact : (B, H) float or None
        Probability of hand contact.
    """

    increments: NDArray
    contact: NDArray | None


class Forecaster(Protocol):
    """Forecasts the pose increments of windows."""

    @property
    def summary(self) -> str:
        """What people call it."""

    def forecast(self, batch: Batch, seed: tuple[int, ...]) -> ForecastArrays:
        """Return the forecasts of a batch of `candata.loaders`; `seed` fixes the noise."""


@dataclass(frozen=True)
class Stays:
    """The object stays where it is, and so does the hand's contact."""

    summary: str = "the object stays"

    def forecast(self, batch: Batch, seed: tuple[int, ...] = ()) -> ForecastArrays:
        """Return increments of zero."""
        return ForecastArrays(np.zeros((1, *batch["future_pad"].shape, 6)), _present_contact(batch))


@dataclass(frozen=True)
class KeepsVelocity:
    """The object repeats the step it has just made; none where the row before is not there."""

    summary: str = "the object keeps its velocity"

    def forecast(self, batch: Batch, seed: tuple[int, ...] = ()) -> ForecastArrays:
        """Return the last increment, at every step."""
        horizon, poses = batch["future_pad"].shape[1], batch["history/object_pose"]
        if poses.shape[1] < 2:
            return Stays().forecast(batch)
        last_increment = increments(poses[:, -2:])
        has_no_row_before = np.asarray(batch["history_pad"][:, -2:].any(axis=1))
        last_increment = np.where(has_no_row_before[:, None, None], 0.0, last_increment)
        return ForecastArrays(np.repeat(last_increment, horizon, axis=1)[None], _present_contact(batch))


def _present_contact(batch: Batch) -> NDArray | None:
    """Return the present contact, at every step; None without contact."""
    contact = batch.get("history/contact")
    if contact is None:
        return None
    return np.repeat(contact[:, -1:].astype(float), batch["future_pad"].shape[1], axis=1)


#: What every model is compared with, by name.
BASELINES: dict[str, Forecaster] = {"stays": Stays(), "keeps_velocity": KeepsVelocity()}


class WindowSimulator(Protocol):
    """Makes of windows what a model reads of the simulator."""

    def keys(self, batch: Batch) -> dict[str, NDArray[np.float32]]:
        """Return `simulated/object_pose (B, H, 7)` and `simulated/contact (B, H)` of a batch of `candata.loaders`."""


@dataclass(frozen=True)
class TrainedModel:
    """A trained model.

    Attributes
    ----------
    module : torch.nn.Module
        With its weights, on `device`.
    clouds : (C, N, 3) Tensor
        Point clouds, on `device`.
    samples, steps : int
        Samples of each forecast, and steps of the sampler.
    device : str
        `cpu` or `cuda`.
    summary : str
        Name for people.
    simulator : WindowSimulator or None
        What makes the forecasts that the model reads; None for a model that reads none.
    """

    module: torch.nn.Module
    clouds: torch.Tensor
    samples: int
    steps: int
    device: str = "cpu"
    summary: str = "the model"
    simulator: WindowSimulator | None = None

    def forecast(self, batch: Batch, seed: tuple[int, ...]) -> ForecastArrays:
        """Return the model's forecasts, a few hundred windows at a time."""
        if self.simulator is not None:
            batch = {**batch, **self.simulator.keys(batch)}
        count = len(batch["history_pad"])
        own_streams = NOISE_NUMBERS in batch
        parts = [
            self._part(batch, slice(i, i + _AT_ONCE), seed if own_streams else (*seed, i))
            for i in range(0, count, _AT_ONCE)
        ]
        contacts = [part.contact for part in parts if part.contact is not None]
        return ForecastArrays(
            np.concatenate([part.increments for part in parts], axis=1),
            np.concatenate(contacts) if contacts else None,
        )

    def _part(self, batch: Batch, part: slice, seed: tuple[int, ...]) -> ForecastArrays:
        """Return the forecasts of some windows."""
        import torch

        from candata.training.feed import tensors
        from candata.training.state import generator, window_generators

        arrays = {name: values[part] for name, values in batch.items()}
        numbers = arrays.pop(NOISE_NUMBERS, None)
        draws = (
            generator(self.device, *seed) if numbers is None else window_generators(self.device, seed, numbers.tolist())
        )
        module: Any = self.module
        with torch.no_grad():
            forecast = module.forecast(tensors(arrays, self.clouds, self.device), self.samples, self.steps, draws)
        contact = None if forecast.contact is None else forecast.contact.double().cpu().numpy()
        return ForecastArrays(forecast.increments.double().cpu().numpy(), contact)
