"""Joints of a closed loop that follow their commands: a first-order lag a joint, fitted on recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from candata.errors import DataError
from candata.loaders import Windows
from candata.training.rollout import Course

Array = NDArray[np.float64]

#: Time constants that are tried [s]. Chosen: from below a row at 80 Hz to a second, 20 % apart.
TIME_CONSTANTS_S = np.geomspace(0.01, 1.0, 26)
#: Episodes that are fitted at most, evenly spread. Chosen: thousands of rows for three numbers a joint.
MOST_EPISODES = 32


@dataclass(frozen=True)
class ServoLags:
    """How each joint follows the actuator of its name.

    Attributes
    ----------
    joints, actuators : (n,) int64
        Columns of `joint_position` and of `action`.
    time_constant_s, gain, offset : (n,) float64
        q moves towards gain u + offset with this time constant.
    """

    joints: NDArray[np.int64]
    actuators: NDArray[np.int64]
    time_constant_s: Array
    gain: Array
    offset: Array

    def follow(self, start: Array, commands: Array, rate_hz: float) -> Array:
        """Return the joints `(T, n)` after each of some commands `(T, A)`, held for a row, from `start (n,)`."""
        decay = np.exp(-1 / (rate_hz * self.time_constant_s))
        targets = self.gain * commands[:, self.actuators] + self.offset
        columns = zip(decay, targets.T, start, strict=True)
        return np.stack([lfilter([1 - a], [1, -a], u, zi=[a * q])[0] for a, u, q in columns], axis=1)


def fit_servo_lags(windows: Windows) -> ServoLags:
    """Return the lags that follow the recorded joints best over the windows' training episodes.

    The error is that of the joints as simulated from an episode's first row, so that noise of the readings does not
    bias it. Gain and offset are in closed form for a time constant, which is searched. Joints without an actuator of
    their name are not among them.

    Raises
    ------
    DataError
        When joints or actions are not recorded, or no actuator bears the name of a joint.
    """
    joints, actuators = _pairs(windows)
    cache = windows.cache
    count = min(MOST_EPISODES, len(windows.fit_episodes))
    chosen = windows.fit_episodes[np.linspace(0, len(windows.fit_episodes) - 1, count).round().astype(int)]
    normal = np.zeros((len(TIME_CONSTANTS_S), len(joints), 2, 2))
    moment = np.zeros((len(TIME_CONSTANTS_S), len(joints), 2))
    energy = np.zeros((len(TIME_CONSTANTS_S), len(joints)))
    for episode in chosen.tolist():
        rows = cache.rows[cache.begin[episode] : cache.end[episode]]
        position = rows["joint_position"][:, joints].astype(np.float64)
        command = rows["action"][:, actuators].astype(np.float64)
        valid = cache.valid[cache.begin[episode] + 1 : cache.end[episode]]
        for k, time_constant_s in enumerate(TIME_CONSTANTS_S):
            decay = np.exp(-1 / (cache.file.rate_hz[episode] * time_constant_s))
            fading = decay ** np.arange(1, len(rows))[:, None]
            follows = lfilter([1 - decay], [1, -decay], command[:-1], axis=0)
            regressors = np.stack([follows, np.broadcast_to(1 - fading, follows.shape)], axis=-1)[valid]
            moved = (position[1:] - fading * position[0])[valid]
            normal[k] += np.einsum("tja,tjb->jab", regressors, regressors)
            moment[k] += np.einsum("tja,tj->ja", regressors, moved)
            energy[k] += (moved**2).sum(axis=0)
    return _best(joints, actuators, normal, moment, energy)


def _best(
    joints: NDArray[np.int64], actuators: NDArray[np.int64], normal: Array, moment: Array, energy: Array
) -> ServoLags:
    """Return the lags with the least squared error: of sums by time constant `(K, n, ...)`."""
    solution = np.einsum("kjab,kjb->kja", np.linalg.pinv(normal, hermitian=True), moment)
    error = energy - np.einsum("kja,kja->kj", solution, moment)
    best, each = error.argmin(axis=0), np.arange(len(joints))
    gain, offset = solution[best, each].T
    return ServoLags(joints, actuators, TIME_CONSTANTS_S[best], gain, offset)


def _pairs(windows: Windows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the columns of joints and of the actuators of their names."""
    names = {name: column for column, name in enumerate(windows.actuator_names)}
    recorded = {"joint_position", "action"} <= set(windows.channels)
    columns = [(j, names[name]) for j, name in enumerate(windows.joint_names) if name in names] if recorded else []
    if not columns:
        raise DataError(
            "no servo to model",
            expected="joint positions and actions, with actuators that bear the names of joints",
            found=f"joints {', '.join(windows.joint_names) or 'none'}; "
            f"actuators {', '.join(windows.actuator_names) or 'none'}",
            fix="leave --joints out: recorded joints are replayed",
        )
    joints, actuators = np.array(columns, np.int64).T
    return joints, actuators


def followed_joints(course: Course, lags: ServoLags) -> Array:
    """Return the joints `(E, N, J)` of a course at the steps of its loops, from the row at which each begins.

    Joints without a lag are the recorded ones.
    """
    windows, cache = course.windows, course.windows.cache
    joints = np.zeros((*course.valid.shape, len(windows.joint_names)))
    for k, (episode, start) in enumerate(zip(course.episodes.tolist(), windows.present_row.tolist(), strict=True)):
        stride, steps = int(windows.stride[episode]), int(course.steps[k])
        rows = cache.rows[start : start + steps * stride + 1]
        joints[k, :steps] = rows["joint_position"][stride::stride]
        begin = rows["joint_position"][0, lags.joints].astype(np.float64)
        follows = lags.follow(begin, rows["action"][:-1].astype(np.float64), cache.file.rate_hz[episode])
        joints[k, :steps, lags.joints] = follows[stride - 1 :: stride].T
    return joints
