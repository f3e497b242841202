"""A slow observer: pulls a replayed state towards its recording, so that errors do not pile up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.rotation import conjugate, normalise, product
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Sine of a turn below which its axis means nothing.
SMALLEST_SINE = 1e-12
#: Share of a joint's error that its average takes up each control step, and the part of the encoders' noise up to which
#: an average says nothing. The average holds a third of the noise, so this is one and a half of its standard errors.
#: Chosen on seven hands: see docs/decisions/0010-observer.md.
ERROR_AVERAGE_SHARE, NOISE_SHARE = 0.2, 0.5


@dataclass(frozen=True)
class Observer:
    """What to follow and how fast.

    Attributes
    ----------
    recorded : mapping of str to ndarray
        `joint_position (n, T, J)`, `object_pose (n, T, 7)` as the recording says that they truly were, see `followed`;
        channels that are missing are not followed. Rows that are not finite are skipped.
    joint_gain, pose_gain : float
        Share of the error removed each control step.
    joint_noise : float or (J,) float64
        Noise of recorded joint positions [rad; m of slides], one standard deviation. Where there is some, the error of
        a joint is averaged, and no more of it than lies beyond half of the noise is removed: pushed about by noise, a
        finger that is jammed or slips comes loose when it did not.
    free_gain : float
        Share of the pose error removed while nothing touches the object, or the error passes the guard.
    guard_m, guard_rad : float
        Pose error from which `free_gain` applies.
    """

    recorded: Mapping[str, Array]
    joint_gain: float = 0.02
    pose_gain: float = 0.006
    joint_noise: float | Array = 0.0
    free_gain: float = 0.15
    guard_m: float = 0.012
    guard_rad: float = 0.2


@dataclass(frozen=True)
class Prescribed:
    """A path on which part of a state is set, row by row, while the rest moves by itself.

    Attributes
    ----------
    qpos_address, qvel_address : (P,), (V,) int64
        Which numbers of qpos and qvel are set.
    qpos, qvel : (n, T, P), (n, T, V) float64
        What they are set to at each row.
    free_address : (F,) int64
        The other numbers of qvel.
    kept : float
        Share of their speed that these keep each row: one lets them move, less brings them to rest.
    """

    qpos_address: NDArray[np.int64]
    qvel_address: NDArray[np.int64]
    qpos: Array
    qvel: Array
    free_address: NDArray[np.int64]
    kept: float = 1.0

    def correct(self, row: int, state: Mapping[str, Array], touch: NDArray[np.bool_], qpos: Array, qvel: Array) -> None:
        """Set `qpos (n, nq)` and `qvel (n, nv)` in place to the path at `row`."""
        qpos[:, self.qpos_address], qvel[:, self.qvel_address] = self.qpos[:, row], self.qvel[:, row]
        qvel[:, self.free_address] *= self.kept


class Follower:
    """An observer made ready for a run: what it pulls towards, and how hard, row by row.

    Parameters
    ----------
    scene : Scene
    observer : Observer
    """

    def __init__(self, scene: Scene, observer: Observer) -> None:
        self._observer = observer
        self._joints, self._object = scene.joint_qpos, None
        recorded_joints = observer.recorded.get("joint_position") if len(scene.joint_qpos) else None
        self._angles = None if recorded_joints is None else _followed_joints(recorded_joints, observer.joint_gain)
        self._error: Array | float = 0.0
        pose = observer.recorded.get("object_pose") if scene.object_id is not None else None
        if pose is not None:
            pose_seen = np.asarray(np.isfinite(pose).all(2))
            self._object = scene.object_qpos
            self._position = np.where(pose_seen[:, :, None], pose[:, :, :3], 0.0)
            self._turn = np.where(pose_seen[:, :, None], pose[:, :, 3:], [1.0, 0.0, 0.0, 0.0])
            self._free, self._slow = observer.free_gain * pose_seen, observer.pose_gain * pose_seen

    def correct(self, row: int, state: Mapping[str, Array], touch: NDArray[np.bool_], qpos: Array, qvel: Array) -> None:
        """Pull `qpos (n, nq)` in place towards the recording at `row`; `qvel` stays as it is.

        `state` is what perfect sensors read of it, and `touch (n,)` whether anything touches the object.
        """
        if self._angles is not None:
            (target, gain), now = self._angles, state["joint_position"]
            qpos[:, self._joints] = now + gain[:, row] * self._error_beyond_noise(
                target[:, row] - now, gain[:, row] > 0
            )
        at = self._object
        if at is None:
            return
        now = qpos[:, at + 3 : at + 7]
        shift = self._position[:, row] - qpos[:, at : at + 3]
        turn = product(self._turn[:, row], conjugate(now))
        cosine, axis = turn[:, :1], turn[:, 1:]
        sine = np.sqrt((axis**2).sum(1, keepdims=True))
        half = np.arctan2(sine, np.abs(cosine))
        guard = self._observer
        far = ((shift**2).sum(1) > guard.guard_m**2) | (half[:, 0] > guard.guard_rad / 2)
        gain = np.where(far | ~touch, self._free[:, row], self._slow[:, row])[:, None]
        qpos[:, at : at + 3] += gain * shift
        # Of the shorter way round, that share.
        size = np.copysign(np.sin(gain * half) / np.maximum(sine, SMALLEST_SINE), cosine)
        part = np.concatenate([np.cos(gain * half), size * axis], axis=1)
        qpos[:, at + 3 : at + 7] = normalise(product(part, now))

    def _error_beyond_noise(self, error: Array, is_seen: NDArray[np.bool_]) -> Array:
        """Return the averaged errors `(n, J)` of the joints beyond their noise; rows that were not seen add nothing."""
        noise = self._observer.joint_noise
        if not np.any(noise):
            return error
        self._error = np.where(
            is_seen, ERROR_AVERAGE_SHARE * error + (1 - ERROR_AVERAGE_SHARE) * self._error, self._error
        )
        return self._error - np.clip(self._error, -NOISE_SHARE * noise, NOISE_SHARE * noise)


def _followed_joints(positions: Array, gain: float) -> tuple[Array, Array]:
    """Return what is pulled towards and how hard; not at all where the recording tells nothing."""
    is_seen = np.isfinite(positions)
    return np.where(is_seen, positions, 0.0), gain * is_seen
