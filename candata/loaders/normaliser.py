"""Normaliser: centre and scale of channels and of pose increments, a value that goes with a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from candata.errors import DataError, UnknownNameError, UsageError
from candata.loaders.increments import increments
from candata.schema.channels import CHANNELS, QUATERNION
from candata.schema.record import Record
from candata.statistics import MAD_TO_SD

Method = Literal["robust", "std", "quantile"]
METHODS = ("robust", "std", "quantile")

#: Tails of a channel that lie outside the range below, and half that range in standard deviations of a normal
#: distribution, Phi^-1(1 - TAIL). A force that is zero most of the time has a MAD of zero; the range still says how
#: large it gets. Chosen: a spike in a thousand rows does not count, a finger that touches in one of a hundred does.
TAIL, TAIL_STD = 0.001, 3.0902

#: Least scale of a channel, in SI units (1 cm, 10 mrad, 10 mN): a joint that never moves in the training data must
#: not explode once it does. Chosen: below what matters to a hand.
CHANNEL_FLOOR = 0.01

#: Least scale of an increment, dp [m] and omega [rad]: an object that never moves. Chosen: a tenth of the pose noise
#: that the built-in scenes declare.
INCREMENT_FLOOR = np.array([1e-4] * 3 + [1e-3] * 3)

#: Rows or windows that are read at most; beyond, every n-th is taken.
SAMPLE = 200_000


class Scale(Record):
    """Centre and scale of the elements of a step, in the order of `shape` flattened: (x - centre) / scale."""

    shape: tuple[int, ...]
    centre: tuple[float, ...]
    scale: tuple[float, ...]

    def arrays(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return centre and scale as `shape` arrays."""
        centre, scale = (np.array(x, np.float32).reshape(self.shape) for x in (self.centre, self.scale))
        return centre, scale


class Normaliser(Record):
    """Scales fitted on the training episodes only; plain JSON by `model_dump_json`, back by `model_validate_json`.

    `clipped` counts, for `quantile`, the fitted values of each channel beyond [-1, 1], which are set to its ends.
    `channels` holds the float channels of the windows; quaternions keep centre 0 and scale 1, the three axes of a
    position share one scale. `increments` is `(H, 6)`, dp [m] and omega [rad] at the model's rate, mean and standard
    deviation by step; null where the windows have no object pose. `rows` and `windows` say how many were read.
    """

    method: Method
    dataset: str
    digest: str
    episodes: int
    rows: int
    windows: int
    rate_hz: float
    horizon: int
    channels: dict[str, Scale]
    increments: Scale | None
    clipped: dict[str, int] = Field(default_factory=dict)

    @property
    def clips(self) -> bool:
        """Whether what is normalised is set to the ends of [-1, 1] beyond them."""
        return self.method == "quantile"

    def channel(self, name: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return centre and scale of a channel, in its shape without the time axis.

        Raises
        ------
        UnknownNameError
            When the channel was not fitted; lists those that were.
        """
        return self.scale_of(name).arrays()

    def scale_of(self, name: str) -> Scale:
        """Return the scale of a channel.

        Raises
        ------
        UnknownNameError
            When the channel was not fitted; lists those that were.
        """
        if name not in self.channels:
            raise UnknownNameError("channel of the normaliser", name, self.channels)
        return self.channels[name]


class Sample(NamedTuple):
    """The rows and poses that a normaliser is fitted on.

    Attributes
    ----------
    rows : (n,) structured
        Valid rows; a field a channel.
    poses : (m, H + 1, 7)
        Pose of the present row and of the horizon; m is 0 where the rows hold no object pose.
    is_real : (m, H) bool
        Steps whose two poses are both real.
    """

    rows: NDArray
    poses: NDArray
    is_real: NDArray[np.bool_]


def channel_scale(name: str, values: NDArray, method: Method = "robust") -> Scale:
    """Return centre and scale of one channel.

    Parameters
    ----------
    name : str
        Name of the channel; decides what is treated as position and quaternion.
    values : (n, ...) float
        Valid values.
    method : str
        `robust`: median, and the larger of 1.4826 MAD and the range of all but the outer 0.1 % on each side, in
        standard deviations; `std`: mean and standard deviation; `quantile`: middle and half width of that range, so
        that it becomes [-1, 1].

    Raises
    ------
    DataError
        When there is no value.
    UnknownNameError
        When the method is unknown.
    """
    if not len(values):
        raise DataError(f"no valid value of {name} to fit a normaliser on", fix="train on episodes that hold it")
    columns = np.asarray(values, np.float64).reshape(len(values), -1)
    centre, scale = _centre_and_scale(columns, method)
    if name in QUATERNION:
        scale[:3] = scale[:3].max()
        centre[QUATERNION[name]], scale[QUATERNION[name]] = 0, 1
    return Scale(shape=values.shape[1:], centre=tuple(centre.tolist()), scale=tuple(scale.tolist()))


def _centre_and_scale(values: NDArray, method: Method) -> tuple[NDArray, NDArray]:
    """Return both `(n,)` for `(rows, n)` values."""
    if method not in METHODS:
        raise UnknownNameError("method of a normaliser", method, METHODS)
    if method == "std":
        return values.mean(0), np.maximum(values.std(0), CHANNEL_FLOOR)
    low, high = np.quantile(values, [TAIL, 1 - TAIL], axis=0)
    if method == "quantile":
        return (low + high) / 2, np.maximum((high - low) / 2, CHANNEL_FLOOR)
    centre = np.median(values, 0)
    scale = np.maximum(MAD_TO_SD * np.median(np.abs(values - centre), 0), (high - low) / (2 * TAIL_STD))
    return centre, np.maximum(scale, CHANNEL_FLOOR)


def increment_scale(poses: NDArray, is_real: NDArray[np.bool_]) -> Scale:
    """Return mean and standard deviation of the increments by step, `(H, 6)`.

    A step that no episode reaches takes those of all steps together.

    Parameters
    ----------
    poses : (n, H + 1, 7)
        Pose of the present row and of the horizon.
    is_real : (n, H) bool
        Steps whose two poses are both real.

    Raises
    ------
    DataError
        When there is no real increment at all.
    """
    if not is_real.any():
        raise DataError("no real pose increment to fit a normaliser on", fix="train on episodes that hold the pose")
    steps = increments(poses)
    steps_by_horizon = [
        steps[is_real[:, k], k] if is_real[:, k].any() else steps[is_real] for k in range(is_real.shape[1])
    ]
    centre = np.stack([step.mean(0) for step in steps_by_horizon])
    spread = np.stack([step.std(0) for step in steps_by_horizon])
    scale = np.maximum(spread, INCREMENT_FLOOR)
    return Scale(shape=centre.shape, centre=tuple(centre.ravel().tolist()), scale=tuple(scale.ravel().tolist()))


def fit_normaliser(method: Method, sample: Sample, **facts: Any) -> Normaliser:
    """Return the normaliser of a sample.

    Parameters
    ----------
    method : str
        As for `channel_scale`.
    sample : Sample
        Rows and poses.
    **facts
        The other fields of the normaliser.

    Raises
    ------
    DataError, UnknownNameError
        As `channel_scale` and `increment_scale`.
    """
    rows = sample.rows
    names = float_channels(rows.dtype.names or ())
    scales = {name: channel_scale(name, rows[name], method) for name in names}
    clipped_counts = (
        {name: _clipped_count(rows[name], scales[name], name) for name in names} if method == "quantile" else {}
    )
    return Normaliser(
        method=method,
        rows=len(rows),
        windows=len(sample.is_real),
        channels=scales,
        increments=increment_scale(sample.poses, sample.is_real) if "object_pose" in names else None,
        clipped=clipped_counts,
        **facts,
    )


def _clipped_count(values: NDArray, scale: Scale, name: str) -> int:
    """Return how many values would be clipped."""
    is_outside = np.abs(_rescale(values, scale)) > 1
    return int(np.delete(is_outside, QUATERNION[name], axis=1).sum() if name in QUATERNION else is_outside.sum())


def normalise_batch(batch: Mapping[str, NDArray], normalisers: Normaliser | Sequence[Normaliser]) -> dict[str, NDArray]:
    """Return the batch with its float channels normalised; quaternions, flags and indices stay as they are.

    Parameters
    ----------
    batch : mapping
        As `Windows.batch` gives it.
    normalisers : Normaliser, or one a domain
        Shared statistics, or separate ones in the order of the mixture's names, taken by the `domain` of each window.

    Raises
    ------
    UsageError
        When there are several and the batch has no `domain`.
    UnknownNameError
        When a channel was not fitted.
    """
    is_shared = isinstance(normalisers, Normaliser)
    if not is_shared and "domain" not in batch:
        raise UsageError("the batch names no domain", expected="windows of mix(...)", fix="give one normaliser")
    domain_normalisers = [normalisers] if isinstance(normalisers, Normaliser) else list(normalisers)
    domain = np.zeros(len(batch["history_pad"]), np.int64) if is_shared else batch["domain"]
    out = dict(batch)
    for key, values in batch.items():
        name = key.partition("/")[2]
        if name not in float_channels((name,) if name in CHANNELS else ()):
            continue
        out[key] = np.empty(values.shape, np.float32)
        for number, normaliser in enumerate(domain_normalisers):
            in_domain = domain == number
            unit_values = _rescale(values[in_domain], normaliser.scale_of(name))
            out[key][in_domain] = unit_values.clip(-1, 1) if normaliser.clips else unit_values
    return out


def _rescale(values: NDArray, scale: Scale) -> NDArray[np.float32]:
    """Return values less the centre, over the scale."""
    centre, width = scale.arrays()
    result: NDArray[np.float32] = (values - centre) / width
    return result


def float_channels(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the channels that are normalised: those of floats."""
    return tuple(name for name in names if CHANNELS[name].dtype == "float32")
