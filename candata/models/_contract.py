"""What a model is: channels it reads, presets, and a module with a loss and a forecast."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import torch

    from candata.schema.record import Record

#: Name to tensor, as `candata.loaders.windows` gives them: raw SI values, which the module normalises itself.
Batch = Mapping[str, "torch.Tensor"]
#: Name of a term to its value; `loss` is the one that is minimised.
Losses = Mapping[str, "torch.Tensor"]


@dataclass(frozen=True)
class Sizes:
    """What the data fix of a model.

    Attributes
    ----------
    history : int
        Rows of the past, the present one included (K + 1).
    horizon : int
        Steps to forecast (H).
    joints, actuators, fingertips : int
        J, A, F.
    points : int
        Points of an object's cloud (N); 0 where the data hold no clouds.
    """

    history: int
    horizon: int
    joints: int
    actuators: int
    fingertips: int
    points: int


@dataclass(frozen=True)
class Forecast:
    """What a model says of B windows in M samples.

    Attributes
    ----------
    increments : (M, B, H, 6) float32
        Pose increments in SI units: dp = p(t+k) - p(t+k-1) [m], then the world-frame rotation vector
        omega with R(t+k) = exp(omega^) R(t+k-1) [rad].
    contact : (B, H) float32 or None
        Probability of hand contact at each step; None for a model that does not forecast it.
    """

    increments: torch.Tensor
    contact: torch.Tensor | None


class Module(Protocol):
    """The torch module that `Model.build` returns (beside being a `torch.nn.Module`)."""

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return the terms of the loss, means over the batch; noise is drawn from `generator`.

        With `masked_mean`, and noise from `candata.models.normal`, `uniform` and `integers`, several processes that
        share a batch train as one.
        """

    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return `samples` forecasts; `steps` sampling steps where the model samples."""


@dataclass(frozen=True)
class Model:
    """A trainable dynamics model.

    Attributes
    ----------
    summary : str
        One line for people.
    channels : tuple of str
        Channels its windows must always hold.
    presets : mapping of str to Record
        `small`, `base`, `paper`: configurations.
    parse : callable
        `(plain values) -> configuration`, checked; raises UsageError.
    build : callable
        `(configuration, sizes, normaliser) -> Module`; the normaliser's values become buffers, and the
        configuration's `seed` alone decides the first weights.
    optional : mapping of str to str
        Field of the configuration that is true or false, to the channel read where it is true.
    needs_simulator : bool
        Whether its batches hold what the simulator makes of each window: `simulated/object_pose (B, H, 7)` and
        `simulated/contact (B, H)`, float32.
    """

    summary: str
    channels: tuple[str, ...]
    presets: Mapping[str, Record]
    parse: Callable[[Mapping[str, Any]], Record]
    build: Callable[[Any, Sizes, Any], Any]
    optional: Mapping[str, str] = field(default_factory=dict)
    needs_simulator: bool = False

    def reads(self, config: Any) -> tuple[str, ...]:
        """Return the channels that windows must hold for this configuration."""
        return self.channels + tuple(channel for flag, channel in self.optional.items() if getattr(config, flag))
