"""Episode: aligned arrays on one clock, plus who, what, when; a value without I/O."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from candata.errors import DataError, Where
from candata.schema.channels import CHANNELS, QUATERNION, VALID_SUFFIX, canonical_order
from candata.schema.disturbance import Kick
from candata.schema.effect import EffectSetting
from candata.schema.html_text import summary_table
from candata.schema.record import Record

#: Largest distance of a quaternion's norm from 1; float32 rounding and trackers stay below 1e-3.
QUATERNION_TOLERANCE = 1e-3


class ContactRule(Record):
    """How `fingertip_contact` came from `fingertip_force`; with `release_n`, contact ends below that force only."""

    method: Literal["sum_abs"] = "sum_abs"
    threshold_n: float = 0.3
    newton_per_count: float | None = None
    release_n: float | None = Field(default=None, exclude_if=lambda force: force is None)


class StreamClock(Record):
    """How the clock of one stream was found against the clock of the log.

    `method` is `motion` (its speed against that of the hand's joints), `device_clock` (its own clock against the
    host's stamps) or `stamps` (nothing was fitted: `reason` says why). `offset_s` and `drift_ppm` were taken off its
    stamps. `correlation` is the height of the peak by which they were found, `sharpness` how far it stands above the
    next one, `windows` in how many windows; `residual_s` is how far the windows (or the stamps) lie from the line. By a
    device's clock, the drift is that clock's and the offset how late the host's stamps were in the middle.
    """

    stream: str
    method: Literal["motion", "device_clock", "stamps"]
    offset_s: float = 0.0
    drift_ppm: float = 0.0
    correlation: float | None = None
    sharpness: float | None = None
    windows: int = 0
    residual_s: float | None = None
    reason: str = ""


class Alignment(Record):
    """How the stream was put on the episode's clock."""

    method: str
    offset_s: float = 0.0
    drift_ppm: float = 0.0
    streams: tuple[StreamClock, ...] = Field(default=(), exclude_if=lambda streams: not streams)


class EpisodeMeta(Record):
    """Who, what, when of an episode; `effects` null means not known or withheld.

    `newton_per_count` is the scale of `taxels`. `labels` are what is known of the run: settings and quantities, with
    the unit in the name. `unscaled` lists channels that are kept in a unit of the source that is no SI unit, or not
    known: their shape in time counts, their size does not. `kicks` are what disturbed a simulation.
    """

    id: str
    source: Literal["sim", "real"]
    rate_hz: float
    scene: str | None = None
    object: str | None = None
    task: str | None = None
    seed: int | None = None
    effects: tuple[EffectSetting, ...] | None = None
    outcome: str | None = None
    force: Literal["mean", "instant"] = "mean"
    action: Literal["next", "previous"] = "next"
    joint_names: tuple[str, ...] = ()
    actuator_names: tuple[str, ...] = ()
    fingertip_names: tuple[str, ...] = ()
    contact_rule: ContactRule | None = None
    newton_per_count: float | None = None
    point_cloud: str | None = None
    alignment: Alignment | None = None
    invalid_counts: dict[str, int] = {}
    labels: dict[str, bool | int | float | str] = {}
    unscaled: tuple[str, ...] = ()
    kicks: tuple[Kick, ...] = Field(default=(), exclude_if=lambda kicks: not kicks)


@dataclass(frozen=True, eq=False)
class Episode:
    """Aligned channels of one recording, validated when made.

    Attributes
    ----------
    meta : EpisodeMeta
        Who, what, when.
    arrays : mapping of str to ndarray
        Channel name (or `<channel>_valid`) to a read-only array; shapes, dtypes and units as in
        `candata.schema.channels.CHANNELS`.

    Raises
    ------
    DataError
        When a channel is unknown, has the wrong shape or length, time does not increase, or a value
        that counts as valid is not finite or no unit quaternion.
    """

    meta: EpisodeMeta
    arrays: Mapping[str, NDArray]

    def __post_init__(self) -> None:
        """Cast to the schema's dtypes, check, and freeze the arrays."""
        for problem in problems(self.meta, self.arrays):
            raise problem
        cast = {}
        for name in canonical_order(list(self.arrays)):
            dtype = "bool" if name.endswith(VALID_SUFFIX) else CHANNELS[name].dtype
            cast[name] = np.array(self.arrays[name], dtype=dtype, order="C")
            cast[name].flags.writeable = False
        object.__setattr__(self, "arrays", MappingProxyType(cast))

    def __repr__(self) -> str:
        """Return id, length and channels in one line."""
        return f"Episode({self.meta.id!r}, {self._length()}, {', '.join(self._channels())})"

    def _repr_html_(self) -> str:
        """Return the channels as a table: what a notebook shows."""
        meta = self.meta
        labels = (meta.source, meta.scene, meta.object, meta.task, meta.outcome)
        facts = ", ".join([*filter(None, labels), self._length()])
        columns = ("channel", "shape", "unit", "invalid rows", "meaning")
        return summary_table(f"Episode {meta.id}", facts, columns, map(self._row, self._channels()))

    def _row(self, name: str) -> tuple[object, ...]:
        """Return the row of a channel: name, shape, unit, invalid rows, meaning."""
        channel = CHANNELS[name]
        return name, self.arrays[name].shape, channel.unit, int((~self.valid(name)).sum()), channel.meaning

    def _length(self) -> str:
        """Return rows, duration and rate."""
        return f"{len(self):,} rows in {self.time_s[-1]:.3g} s at {self.meta.rate_hz:g} Hz"

    def _channels(self) -> list[str]:
        """Return the names of the channels, without the flags of their validity."""
        return [name for name in self.arrays if not name.endswith(VALID_SUFFIX)]

    def __len__(self) -> int:
        """Return the number of rows T."""
        return len(self.arrays["time_ns"])

    def __contains__(self, channel: str) -> bool:
        """Tell whether the episode holds `channel`."""
        return channel in self.arrays

    def __getitem__(self, channel: str) -> NDArray:
        """Return the array of `channel`.

        Raises
        ------
        DataError
            When the episode lacks it; lists what it has.
        """
        if channel not in self.arrays:
            raise DataError(
                f"episode has no channel {channel}",
                expected=channel,
                found=", ".join(self.arrays),
                where=Where(episode=self.meta.id),
            )
        return self.arrays[channel]

    def valid(self, channel: str) -> NDArray[np.bool_]:
        """Return `(T,) bool`: the rows in which `channel` holds a value."""
        return self.arrays.get(channel + VALID_SUFFIX, np.ones(len(self), bool))

    @property
    def time_s(self) -> NDArray[np.float64]:
        """`(T,) float64 [s]`, zero at the first row."""
        time_ns = self.arrays["time_ns"]
        return (time_ns - time_ns[0]) * 1e-9


def problems(meta: EpisodeMeta, arrays: Mapping[str, NDArray]) -> Iterator[DataError]:
    """Yield everything that keeps `arrays` from being an episode, the first cause first.

    Used by `Episode` (which raises the first) and by the checks (which report all).
    """
    yield from _structure(meta, arrays)
    if not all(n.removesuffix(VALID_SUFFIX) in CHANNELS for n in arrays) or "time_ns" not in arrays:
        return
    yield from _time(meta, np.asarray(arrays["time_ns"]))
    for name in canonical_order([n for n in arrays if not n.endswith(VALID_SUFFIX)]):
        yield from _values(meta, name, arrays)


def _structure(meta: EpisodeMeta, arrays: Mapping[str, NDArray]) -> Iterator[DataError]:
    """Yield unknown channels, missing required ones and wrong shapes."""
    for name in arrays:
        if name.removesuffix(VALID_SUFFIX) not in CHANNELS:
            yield DataError(
                f"unknown channel {name!r}",
                expected=", ".join(CHANNELS),
                found=name,
                where=Where(episode=meta.id, channel=name),
            )
            return
    if "time_ns" not in arrays or not ({"object_pose", "joint_position"} & set(arrays)):
        yield DataError(
            "an episode needs time_ns and one of object_pose, joint_position",
            found=", ".join(arrays) or "nothing",
            where=Where(episode=meta.id),
        )
        return
    sizes = {"T": len(arrays["time_ns"])}
    sizes |= {k: len(v) for k, v in _named_sizes(meta).items() if v}
    for name, array in arrays.items():
        symbols = ("T",) if name.endswith(VALID_SUFFIX) else CHANNELS[name].shape
        target_shape = tuple(sizes.get(d, -1) if isinstance(d, str) else d for d in symbols)
        shape = np.shape(array)
        if len(shape) != len(target_shape) or any(w not in (-1, s) for w, s in zip(target_shape, shape, strict=True)):
            yield DataError(
                f"{name} has the wrong shape",
                expected=_shape_text(symbols, target_shape),
                found=str(shape),
                where=Where(episode=meta.id, channel=name),
            )


def _named_sizes(meta: EpisodeMeta) -> dict[str, tuple[str, ...]]:
    """Return the names that fix each symbolic size."""
    return {"J": meta.joint_names, "A": meta.actuator_names, "F": meta.fingertip_names}


def _shape_text(symbols: tuple[str | int, ...], sizes: tuple[int, ...]) -> str:
    """Return `(T = 80, 7)`-like text."""
    parts = [
        str(d) if isinstance(d, int) else (f"{d} = {n}" if n >= 0 else d) for d, n in zip(symbols, sizes, strict=True)
    ]
    return f"({', '.join(parts)})"


def _time(meta: EpisodeMeta, time_ns: NDArray) -> Iterator[DataError]:
    """Yield a time that does not increase."""
    if len(time_ns) == 0:
        yield DataError("episode has no rows", expected="at least 1 row", where=Where(episode=meta.id))
    steps = np.flatnonzero(np.diff(time_ns) <= 0)
    if len(steps):
        row = int(steps[0]) + 1
        yield DataError(
            "time does not increase",
            expected=f"more than {time_ns[row - 1]} ns",
            found=f"{time_ns[row]} ns",
            where=Where(episode=meta.id, channel="time_ns", index=row),
            fix="sort the rows by time and drop repeated stamps",
        )


def _counts(meta: EpisodeMeta, name: str, array: NDArray) -> Iterator[DataError]:
    """Yield counts that are not whole, or that int16 does not hold."""
    limits = np.iinfo(np.int16)
    is_integer = array.dtype.kind in "iu"
    may_exceed = array.dtype.itemsize > 1 and array.dtype != np.int16 and array.size > 0
    if not is_integer or (may_exceed and not limits.min <= array.min() <= array.max() <= limits.max):
        yield DataError(
            f"{name} holds no counts",
            expected=f"whole numbers from {limits.min} to {limits.max}",
            found=f"from {array.min()} to {array.max()}" if is_integer else str(array.dtype),
            where=Where(episode=meta.id, channel=name),
            fix="store the counts as they came from the sensor, and the scale as newton_per_count",
        )


def _values(meta: EpisodeMeta, name: str, arrays: Mapping[str, NDArray]) -> Iterator[DataError]:
    """Yield non-finite values and non-unit quaternions in valid rows."""
    array = np.asarray(arrays[name])
    if np.dtype(CHANNELS[name].dtype) == np.int16:
        yield from _counts(meta, name, array)
        return
    if array.dtype.kind != "f" or array.ndim == 0:
        return
    valid = np.asarray(arrays.get(name + VALID_SUFFIX, np.ones(len(array), bool)))
    if len(valid) != len(array):
        return
    invalid_rows = np.flatnonzero(valid & ~np.isfinite(array).reshape(len(array), -1).all(1))
    if len(invalid_rows):
        yield DataError(
            f"{name} is not finite",
            expected="finite numbers where valid",
            found=f"{len(invalid_rows)} such rows",
            where=Where(episode=meta.id, channel=name, index=int(invalid_rows[0])),
            fix="mark gaps as invalid: import with --allow-gaps",
        )
    if name in QUATERNION and array.ndim == 2 and array.shape[1] == 7:
        finite = np.where(np.isfinite(array), array, 0.0).astype(np.float64)  # squares of float32 may overflow
        norm = np.linalg.norm(finite[:, QUATERNION[name]], axis=1)
        invalid_rows = np.flatnonzero(valid & np.isfinite(array).all(1) & (np.abs(norm - 1) > QUATERNION_TOLERANCE))
        if len(invalid_rows):
            yield DataError(
                f"{name} holds a quaternion that is not unit",
                expected=f"norm 1 +- {QUATERNION_TOLERANCE}",
                found=f"norm {norm[invalid_rows[0]]:.4f} ({len(invalid_rows)} rows)",
                where=Where(episode=meta.id, channel=name, index=int(invalid_rows[0])),
                fix="check the order (w x y z) and the columns of the quaternion",
            )
