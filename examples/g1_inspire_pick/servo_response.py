"""How each servo answers its command, by one linear model a joint and no simulator: delay, bandwidth, gain.

The model is a pure delay, then a critically damped second-order lag, then a gain: the least that says "late", "slow"
and "short". Commands are known, so the gain is found in closed form and only two numbers are searched, over all joints
at once. Offsets belong to each episode and are left out: what is compared is movement, not posture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from candata.errors import DataError
from candata.gap.data.recordings import Recordings
from candata.scenes import Scene
from candata.statistics import resamples

Array = NDArray[np.float64]
#: Parts of a recorded row in which delays are tried, and the longest delay [s].
PARTS, LONGEST_S = 4, 0.5
#: Bandwidths that are tried: how many, and their lowest [Hz]; the highest is the Nyquist rate.
BANDWIDTHS, LOWEST_HZ = 36, 0.4
#: Resamples of the episodes, and the ends of a 90 % interval.
RESAMPLES, ENDS = 100, (0.05, 0.95)
#: Parts into which the episodes are cut for the held-out fit.
FOLDS = 4
#: Movement of a command within episodes (1 sd) below which a servo's answer is that of its gears' play and friction,
#: not of its motion [rad, or of a stroke of 1]: about one degree.
LEAST_MOTION = 0.02
#: Share of the movement that the model must foretell on held-out episodes.
LEAST_R2 = 0.5
#: Half power of a critically damped second-order lag lies at this multiple of its natural frequency:
#: (1 + x^2)^2 = 2 (closed form).
HALF_POWER = float(np.sqrt(np.sqrt(2) - 1))


@dataclass(frozen=True)
class ServoResponse:
    """How one joint answers its command.

    Attributes
    ----------
    joint : str
    lag_s, lag_low_s, lag_high_s : float
        Delay plus the lag's own, 2 / natural frequency: what a shift of the signals shows; 90 % interval, no finer than
        the delays that are tried.
    delay_s : float
        Pure delay; with smooth commands it trades against bandwidth.
    bandwidth_hz : float
        Half power of the lag.
    gain : float
        Movement in the long run, over the commanded one.
    r2 : float
        Share of the joint's movement that is foretold on held-out episodes; NaN for a joint that never moves.
    motion : float
        Commanded movement within episodes, 1 sd.
    why_not : str
        Why the numbers mean nothing, or empty.
    """

    joint: str
    lag_s: float
    lag_low_s: float
    lag_high_s: float
    delay_s: float
    bandwidth_hz: float
    gain: float
    r2: float
    motion: float
    why_not: str

    @property
    def identifiable(self) -> bool:
        """Tell whether the numbers mean anything."""
        return not self.why_not


@dataclass(frozen=True)
class _Grid:
    """Delays `(d,)` [s] and natural frequencies `(w,)` [rad/s] that are tried, and sums `(E, w, d, J)` over rows."""

    delay_s: Array
    natural: Array
    uu: Array
    uy: Array
    yy: Array

    def error(self, weight: Array) -> Array:
        """Return the least squared error `(w, d, J)` of episodes weighted by `weight (E,)`."""
        uu, uy, yy = self.summed(weight)
        return yy - uy**2 / np.maximum(uu, 1e-300)

    def summed(self, weight: Array) -> tuple[Array, Array, Array]:
        """Return the weighted sums `(w, d, J)`; that of the positions is `(J,)`."""
        uu, uy = (np.tensordot(weight, s, 1) for s in (self.uu, self.uy))
        return uu, uy, weight @ self.yy


def servo_responses(scene: Scene, recs: Recordings, rng: np.random.Generator) -> tuple[ServoResponse, ...]:
    """Return how each driven hinge answers its command, in the order of the scene's joints.

    Parameters
    ----------
    scene : Scene
        Says which actuator drives which joint, and the rate; its physics is not used.
    recs : Recordings
        Recorded commands and joint positions.
    rng : numpy.random.Generator
        Folds and resamples of the episodes.

    Raises
    ------
    DataError
        When joint positions, commands or episodes to hold out are missing.
    """
    pairs = _pairs(scene)
    if not pairs or "joint_position" not in recs.readings or len(recs) < FOLDS:
        raise DataError(
            "nothing to tell servos from",
            expected=f"joints with actuators, recorded positions, {FOLDS} episodes",
            found=f"{len(pairs)} driven joints, {', '.join(recs.readings)}, {len(recs)} episodes",
        )
    joints, columns = (np.array(x) for x in zip(*pairs, strict=True))
    position, command = recs.readings["joint_position"][..., joints], recs.commands[..., columns]
    grid = _sums(command, position, recs.lengths, scene.file.rate_hz)
    names = [scene.file.joints[j] for j in joints]
    motion = _motion(command, recs.lengths)
    return tuple(_judged(n, *found) for n, found in zip(names, _fits(grid, motion, rng), strict=True))


def _pairs(scene: Scene) -> list[tuple[int, int]]:
    """Return index into the joints and column of the commands of each hinge that has an actuator of its own."""
    ids = scene.actuator_ids.tolist()
    by_joint = {j: ids.index(a) for a, j in scene.driven_joints.items()}
    own = [(int(i), by_joint.get(int(scene.joint_ids[i]))) for i in scene.driven_hinges]
    return [(i, column) for i, column in own if column is not None]


def _motion(command: Array, lengths: NDArray[np.int64]) -> Array:
    """Return `(J,)` standard deviation of the commands within episodes."""
    return np.sqrt(np.mean([c[:n].var(axis=0) for c, n in zip(command, lengths, strict=True)], axis=0))


def _sums(command: Array, position: Array, lengths: NDArray[np.int64], rate_hz: float) -> _Grid:
    """Return products of filtered, delayed commands and positions, free of each episode's mean."""
    delay = np.arange(round(LONGEST_S * rate_hz * PARTS) + 1) / (rate_hz * PARTS)
    natural = np.geomspace(LOWEST_HZ, rate_hz / 2, BANDWIDTHS) * 2 * np.pi / HALF_POWER
    shape = (len(command), len(natural), len(delay), command.shape[2])
    uu, uy, yy = np.zeros(shape), np.zeros(shape), np.zeros((len(command), command.shape[2]))
    for e, rows in enumerate(lengths):
        seen = np.isfinite(position[e, :rows]).all(1)
        y = position[e, :rows][seen] - position[e, :rows][seen].mean(0)
        yy[e] = (y**2).sum(0)
        at = np.arange(rows)[seen, None] * PARTS - np.arange(len(delay))[None]
        for w, frequency in enumerate(natural):
            answer = _answered(command[e, :rows], frequency, rate_hz)
            u = answer[np.maximum(at, 0)]
            u = u - u.mean(0)
            uu[e, w], uy[e, w] = (u**2).sum(0), np.einsum("tdj,tj->dj", u, y)
    return _Grid(delay, natural, uu, uy, yy)


def _answered(command: Array, natural: float, rate_hz: float) -> Array:
    """Return the critically damped answer `(T P, J)` to held commands, P times a row, from rest.

    Two equal first-order lags in a row, each exact for a held input: y += (1 - exp(-w h)) (u - y). The second one is
    fed by the first's mean over the step, so that the two together delay by 2 / w.
    """
    step = 1 / (rate_hz * PARTS)
    held = np.repeat(command, PARTS, axis=0) - command[0]
    keep = np.exp(-natural * step)
    first = lfilter([0.0, 1 - keep], [1.0, -keep], held, axis=0)
    middle = 0.5 * (first + np.concatenate([first[1:], first[-1:]]))
    return lfilter([0.0, 1 - keep], [1.0, -keep], middle, axis=0)


def _fits(grid: _Grid, motion: Array, rng: np.random.Generator) -> list[tuple]:
    """Return for each joint what `_judged` takes: fit on all episodes, interval, held-out share, motion."""
    count, joints = len(grid.yy), grid.yy.shape[1]
    best = _best(grid, np.ones(count))
    lags = np.stack(
        [
            _lag(grid, *_best(grid, np.bincount(picks, minlength=count).astype(float)))
            for picks in resamples(rng, count, RESAMPLES)
        ]
    )
    low, high = np.quantile(lags, ENDS, axis=0)
    coarse = (grid.delay_s[1] - grid.delay_s[0]) / 2
    uu, uy, _ = grid.summed(np.ones(count))
    each = np.arange(joints)
    gain = uy[(*best, each)] / np.maximum(uu[(*best, each)], 1e-300)
    r2 = _held_out(grid, rng)
    lag = _lag(grid, *best)
    return [
        (
            lag[j],
            low[j] - coarse,
            high[j] + coarse,
            grid.delay_s[best[1][j]],
            grid.natural[best[0][j]],
            gain[j],
            r2[j],
            motion[j],
        )
        for j in each
    ]


def _best(grid: _Grid, weight: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices `(J,)` of frequency and delay of least error."""
    error = grid.error(weight)
    flat = error.reshape(-1, error.shape[2]).argmin(0)
    return np.unravel_index(flat, error.shape[:2])  # type: ignore[return-value]


def _lag(grid: _Grid, frequency: NDArray[np.int64], delay: NDArray[np.int64]) -> Array:
    """Return the lag `(J,)` [s] of delay and low-pass together."""
    return grid.delay_s[delay] + 2 / grid.natural[frequency]


def _held_out(grid: _Grid, rng: np.random.Generator) -> Array:
    """Return `(J,)` share of the movement that is foretold on episodes that the fit has not seen."""
    count, joints = len(grid.yy), grid.yy.shape[1]
    part = rng.permutation(count) % FOLDS
    left = np.zeros(joints)
    for f in range(FOLDS):
        train, test = (part != f).astype(float), (part == f).astype(float)
        at = (*_best(grid, train), np.arange(joints))
        uu, uy, _ = grid.summed(train)
        gain = uy[at] / np.maximum(uu[at], 1e-300)
        uu, uy, yy = grid.summed(test)
        left += yy - 2 * gain * uy[at] + gain**2 * uu[at]
    total = grid.yy.sum(0)
    return np.where(total > 0, 1 - left / np.maximum(total, 1e-300), np.nan)


def _judged(
    joint: str, lag: float, low: float, high: float, delay: float, natural: float, gain: float, r2: float, motion: float
) -> ServoResponse:
    """Return the response of a joint with why it means nothing, if so."""
    why = ""
    if motion < LEAST_MOTION:
        why = "its command hardly moves"
    elif not r2 > LEAST_R2:
        why = "it does not follow its command"
    return ServoResponse(
        joint=joint,
        lag_s=float(lag),
        lag_low_s=float(low),
        lag_high_s=float(high),
        delay_s=float(delay),
        bandwidth_hz=float(natural * HALF_POWER / (2 * np.pi)),
        gain=float(gain),
        r2=float(r2),
        motion=float(motion),
        why_not=why,
    )
