"""Augmentations: noise on poses and commands of a batch, as a pure function of the batch and a generator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from pydantic import Field

from candata.loaders.gather import Array, Batch
from candata.rotation import exp
from candata.schema.record import Record

#: Entries of a batch that move with the object.
_MOVED = {"history/object_pose", "future/object_pose", "simulated/object_pose"}


class Normals(Protocol):
    """What draws standard normal numbers, as `numpy.random.Generator` does."""

    def standard_normal(self, size: tuple[int, ...], dtype: Any = ...) -> Any:
        """Return `size` numbers."""


class Augmentation(Record):
    """Amounts of noise; all off by default.

    The paper perturbs poses and commands while it simulates and gives no numbers; here recorded windows are perturbed,
    so that what a disturbance does to the object later is not in them: `candata generate-sim` with effects has it.
    Source: "Contact-Aware Neural Dynamics", arXiv 2601.12796, on training with domain randomisation.

    Attributes
    ----------
    position_m : float
        Standard deviation of the shift of the object, by axis of the world [m].
    rotation_rad : float
        Standard deviation of the turn of the object, by axis of its body [rad].
    command : float
        Standard deviation of the noise on each element of a command, in its own unit (rad, m, N m, ...).
    """

    position_m: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    rotation_rad: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    command: float = Field(default=0.0, ge=0, allow_inf_nan=False)

    @property
    def is_off(self) -> bool:
        """Whether nothing is perturbed."""
        return not (self.position_m or self.rotation_rad or self.command)


def augment(batch: Mapping[str, Array], augmentation: Augmentation, rng: Normals) -> Batch:
    """Return the batch with noise; the one given stays as it is.

    - The pose of the object: one shift d and one turn delta a window, the same for all rows of past and
      future, and for simulated poses, which move along: p' = p + d, R' = R exp(delta^). The pose increments, which the
      models forecast, stay the same.
    - Commands: independent noise an element and row; a row that stands both in `history/action` or `future/action` and
      in `planned/action` has the same noise in both.

    Other channels, `object_velocity` among them, are left as they are. Arrays may be numpy's or torch's, on any
    device; the noise is drawn on the host, in the same order whatever is off.

    Parameters
    ----------
    batch : mapping
        As `Windows.batch` or a resident gather gives it.
    augmentation : Augmentation
        Standard deviations of the noise.
    rng : numpy.random.Generator, or what draws like it
        `noise(seed, step, rank)` makes a step's noise a function of these three.
    """
    out = dict(batch)
    turn, shift = (rng.standard_normal((len(batch["history_pad"]), 3)) for _ in range(2))
    if "history/object_pose" in batch and (augmentation.position_m or augmentation.rotation_rad):
        matrix, offset = _rigid(augmentation.rotation_rad * turn, augmentation.position_m * shift)
        for name in _MOVED & set(batch):
            out[name] = batch[name] @ _array_like(matrix, batch[name]) + _array_like(offset, batch[name])
    if "history/action" in batch and augmentation.command:
        history_rows = batch["history/action"].shape[1]
        count, rows, width = len(turn), history_rows + batch["future/action"].shape[1], batch["history/action"].shape[2]
        action_noise = _array_like(
            augmentation.command * rng.standard_normal((count, rows, width), np.float32), batch["history/action"]
        )
        for name, part in (("history", action_noise[:, :history_rows]), ("future", action_noise[:, history_rows:])):
            out[f"{name}/action"] = batch[f"{name}/action"] + part
        out["planned/action"] = batch["planned/action"] + action_noise[:, history_rows - 1 : -1]
    return out


def _rigid(turn: Array, shift: Array) -> tuple[Array, Array]:
    """Return `(B, 7, 7)` and `(B, 1, 7)`: a pose as a row times the first plus the second is the pose moved.

    Source: J. Sola, "Quaternion kinematics for the error-state Kalman filter", arXiv 1711.02508, eq. 19 (the right
    product as a matrix); a row vector takes its transpose.
    """
    w, x, y, z = exp(turn).T
    matrix = np.zeros((len(turn), 7, 7))
    matrix[:, :3, :3] = np.eye(3)
    right_product = [[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]]
    matrix[:, 3:, 3:] = np.moveaxis(np.array(right_product), -1, 0).transpose(0, 2, 1)
    offset = np.concatenate([shift, np.zeros((len(shift), 4))], axis=1)[:, None]
    return matrix, offset


def _array_like(values: Array, sample: Array) -> Array:
    """Return the values as the kind of array that `sample` is, in its dtype and on its device."""
    if isinstance(sample, np.ndarray):
        return values.astype(sample.dtype)
    return sample.new_tensor(values)
