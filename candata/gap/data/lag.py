"""Lagged regression of recorded joints on commands: which command drives which joint, how much, how late."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.scenes import Scene
from candata.scenes.motors import affine_law, has_affine_law, is_position_motor

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Drives:
    """Position servos of a scene that drive recorded joints.

    Attributes
    ----------
    columns, joints : (S,) int64
        Columns of `action` and of `joint_position`.
    slope, offset : (S,) float64
        Joint position at which the servo rests without load: `slope * command + offset`.
    """

    columns: Index
    joints: Index
    slope: Array
    offset: Array

    def targets(self, commands: Array) -> Array:
        """Return `(E, T, S)` where the servos would rest under commands `(E, T, A)`."""
        return commands[..., self.columns] * self.slope + self.offset


def drives(scene: Scene) -> Drives:
    """Return the position servos of a scene; motors, velocity servos and integrators tell nothing of a joint's place.

    A servo pulls with `gain u + b0 + b1 gear q` (MuJoCo manual, "Actuation model"), times its gear, against the
    joint's spring; it rests where both are equal.
    """
    model, rows = scene.model, []
    kinds = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
    motors = is_position_motor(model, np.arange(model.nactuator))
    forgetting = np.isin(model.actuator_dyntype, [int(kind) for kind in kinds]) | (
        motors & (model.actuator_actnum == 0)
    )
    fixed = (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED) | motors
    gains, biases = affine_law(model, scene.actuator_ids)
    known = {int(j): i for i, j in enumerate(scene.joint_ids)}
    for column, a in enumerate(scene.actuator_ids.tolist()):
        joint = known.get(scene.driven_joints.get(a, -1))
        gain, (bias, slope, _), gear = gains[column], biases[column], model.actuator_gear[a]
        if joint is None or slope >= 0 or gain == 0 or gear[0] == 0 or not forgetting[a]:
            continue
        if not has_affine_law(model, [a])[0] or not fixed[a]:
            continue
        j = scene.joint_ids[joint]
        spring = float(np.ravel(model.jnt_stiffness[j])[0])
        stiff = -slope * gear[0] ** 2 + spring
        rest = spring * model.qpos_spring[model.jnt_qposadr[j]]
        rows.append((column, joint, gain * gear[0] / stiff, (bias * gear[0] + rest) / stiff))
    table = np.array(rows, float).reshape(-1, 4)
    return Drives(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2], table[:, 3])


@dataclass(frozen=True)
class Lagged:
    """Pooled moments of J recorded signals against S others at L lags of whole rows.

    Attributes
    ----------
    lags : (L,) int64
        Rows by which the second signal comes before the first.
    count : (L, J) float64
        Rows where both were seen.
    mean_q, var_q : (L, J)
        Of the first signal.
    mean_u, var_u, cov : (L, J, S)
        Of the second, over the rows where the first was seen, and both together.
    """

    lags: Index
    count: Array
    mean_q: Array
    var_q: Array
    mean_u: Array
    var_u: Array
    cov: Array

    def error(self) -> Array:
        """Return `(L, J, S)` the mean squared difference after a constant is taken off."""
        return self.var_q[:, :, None] - 2 * self.cov + self.var_u

    def r2(self) -> Array:
        """Return `(L, J, S)` the squared correlation, 0 where one is still; negative where they run against."""
        size = self.var_q[:, :, None] * self.var_u
        return np.where(size > 0, np.abs(self.cov) * self.cov / np.maximum(size, 1e-30), 0.0)

    def slope(self) -> Array:
        """Return `(L, J, S)` by how much the first moves when the second moves by 1."""
        return self.cov / np.maximum(self.var_u, 1e-30)


def lag_moments(q: Array, u: Array, lags: Index) -> Lagged:
    """Return the moments of `q (E, T, J)` (NaN where not seen) against `u (E, T, S)` at each lag.

    Each lag is judged on the same rows, so that errors can be compared between lags.
    """
    total = q.shape[1]
    first, last = max(0, int(lags.max())), total + min(0, int(lags.min()))
    seen = np.isfinite(q[:, first:last]).reshape(-1, q.shape[2])
    value = np.nan_to_num(q[:, first:last]).reshape(-1, q.shape[2])
    weight, n = seen.astype(float), np.maximum(seen.sum(0), 1)
    mean_q = value.sum(0) / n
    var_q = np.maximum((value**2).sum(0) / n - mean_q**2, 0)
    rows = []
    for lag in lags.tolist():
        other = np.nan_to_num(u[:, first - lag : last - lag]).reshape(-1, u.shape[2])
        mean_u = weight.T @ other / n[:, None]
        var_u = np.maximum(weight.T @ other**2 / n[:, None] - mean_u**2, 0)
        rows.append((mean_u, var_u, value.T @ other / n[:, None] - mean_q[:, None] * mean_u))
    mean_u, var_u, cov = (np.stack(part) for part in zip(*rows, strict=True))
    count, mean, var = (np.repeat(v[None], len(lags), axis=0) for v in (seen.sum(0).astype(float), mean_q, var_q))
    return Lagged(lags, count, mean, var, mean_u, var_u, cov)


def centred(values: Array) -> Array:
    """Return `(E, T, D)` values with each episode's own mean taken off."""
    seen = np.isfinite(values)
    mean = np.where(seen, values, 0.0).sum(1) / np.maximum(seen.sum(1), 1)
    return values - mean[:, None]


def at_best(values: Array, best: Index) -> Array:
    """Return `(J, S)` the values `(L, J, S)` at the lag number `best (J, S)` of each pair."""
    return np.take_along_axis(values, best[None], axis=0)[0]


def own_lag(q: Array, other: Array, reach: int) -> Array:
    """Return `(J,)` rows by which each `q (E, T, J)` comes after its own `other (E, T, J)`, to a part of a row.

    The lag of the largest correlation, refined by the parabola through its neighbours; NaN at the ends of the reach
    and for still signals.
    """
    lags = np.arange(-reach, reach + 1)
    found = lag_moments(centred(q), centred(other), lags)
    r2 = np.diagonal(found.r2(), axis1=1, axis2=2)
    best = r2.argmax(0)
    out = np.full(q.shape[2], np.nan)
    for j in np.flatnonzero((best > 0) & (best < len(lags) - 1) & (r2.max(0) > 0)):
        low, mid, high = r2[best[j] - 1 : best[j] + 2, j]
        bend = low - 2 * mid + high
        out[j] = lags[best[j]] + (0.5 * (low - high) / bend if bend < 0 else 0.0)
    return out
