"""Scores of forecasts: ADD-S and its AUC, energy score, F1."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from candata.rotation import conjugate, multiply, rotate

Array = NDArray[np.float64]

#: Errors beyond this distance count nothing in the area under the curve.
#: Source: Y. Xiang et al., "PoseCNN", RSS 2018, section on evaluation metrics (10 cm).
ADDS_LIMIT_M = 0.1
#: A final position this near the true one is a success. Source: arXiv 2601.12796, section on evaluation.
SUCCESS_M = 0.05
#: Distances that are found at once: half a megabyte of them stays in a core's cache.
_DISTANCES = 1 << 16
#: Poses whose points are moved at once.
_POSES = 8


def adds(cloud: NDArray, predicted: NDArray, truth: NDArray) -> Array:
    """Return ADD-S `(...) [m]`: mean distance of the true cloud's points to the nearest predicted one.

    The true points are moved into the predicted frame, so that one cloud serves all poses.

    Parameters
    ----------
    cloud : (N, 3) [m]
        Points of the object, in its frame.
    predicted, truth : (..., 7)
        Poses [m, w x y z] of equal shape.

    Notes
    -----
    Source: Y. Xiang et al., "PoseCNN", RSS 2018, section on evaluation metrics (ADD-S). The nearest point is that of
    the least |c|^2 - 2 p.c, a matrix product; its distance is then taken from the points themselves, so that nothing
    cancels. Measured against k-d trees of 512 points: a third less time, and the same for poses far apart.
    """
    predicted, truth = (np.asarray(p, np.float64) for p in (predicted, truth))
    predicted_poses, true_poses = predicted.reshape(-1, 7), truth.reshape(-1, 7)
    inverse_turn = conjugate(predicted_poses[:, 3:])
    turn, shift = (
        multiply(inverse_turn, true_poses[:, 3:]),
        rotate(inverse_turn, true_poses[:, :3] - predicted_poses[:, :3]),
    )
    axes = rotate(turn[:, None, :], np.eye(3)[None])  # the images of x, y, z: (poses, 3, 3)
    points = np.asarray(cloud, np.float64)
    centre = points.mean(0)
    centred_points, workspace, distances = (
        points - centre,
        _workspace(max(1, _DISTANCES // len(points)), len(points)),
        np.empty(len(predicted_poses)),
    )
    nearest_operand = np.concatenate(
        [-2 * centred_points, np.square(centred_points).sum(1, keepdims=True)], axis=1
    ).T.copy()
    for begin in range(0, len(predicted_poses), _POSES):
        part = slice(begin, begin + _POSES)
        true_points = points @ axes[part] + (shift[part, None, :] - centre)
        distances[part] = (
            _nearest_distances(true_points.reshape(-1, 3), centred_points, nearest_operand, workspace)
            .reshape(-1, len(points))
            .mean(1)
        )
    return distances.reshape(predicted.shape[:-1])


def _workspace(rows: int, columns: int) -> Array:
    """Return an empty array that begins at a cache line: a product into it takes a quarter less time."""
    buffer = np.empty(rows * columns + 8)
    begin = -(buffer.ctypes.data // 8) % 8
    return buffer[begin : begin + rows * columns].reshape(rows, columns)


def _nearest_distances(points: Array, cloud: Array, nearest_operand: Array, workspace: Array) -> Array:
    """Return the distance `(n,)` of points to the nearest of a cloud.

    Parameters
    ----------
    points : (n, 3)
        In the cloud's frame.
    cloud, nearest_operand : (N, 3), (4, N)
        The cloud, and [-2 c; |c|^2].
    workspace : (rows, N)
        Is written over.
    """
    homogeneous, nearest_index = np.ones((len(points), 4)), np.empty(len(points), np.intp)
    homogeneous[:, :3] = points
    for begin in range(0, len(points), len(workspace)):
        part = slice(begin, begin + len(workspace))
        np.matmul(homogeneous[part], nearest_operand, out=workspace[: len(homogeneous[part])]).argmin(
            1, out=nearest_index[part]
        )
    offsets = cloud.take(nearest_index, axis=0)
    offsets -= points
    np.square(offsets, out=offsets)
    return np.sqrt(offsets[:, 0] + offsets[:, 1] + offsets[:, 2])


def adds_of(clouds: NDArray, cloud: NDArray, predicted: NDArray, truth: NDArray) -> Array:
    """Return ADD-S `(B, ...) [m]` of windows whose objects are `cloud (B,)`, as indices into `clouds (C, N, 3)`."""
    distances = np.empty(np.shape(predicted)[:-1])
    for index in np.unique(cloud):
        of_object = np.asarray(cloud) == index
        distances[of_object] = adds(clouds[index], predicted[of_object], truth[of_object])
    return distances


def auc(errors: NDArray, limit_m: float = ADDS_LIMIT_M) -> float:
    """Return the area under the accuracy-threshold curve up to `limit_m`, 0 to 1, exactly.

    The accuracy at threshold x is the share of errors below x; its integral over [0, limit] divided by the limit is
    the mean of max(0, 1 - e / limit). NaN for no errors.
    """
    errors = np.asarray(errors, np.float64)
    return float(auc_share(errors, limit_m).mean()) if errors.size else math.nan


def auc_share(errors: NDArray, limit_m: float = ADDS_LIMIT_M) -> Array:
    """Return what each error adds to the area of `auc`, 0 to 1: the mean of it is the area."""
    return np.maximum(0.0, 1 - np.asarray(errors, np.float64) / limit_m)


def energy_score(samples: NDArray, truth: NDArray) -> Array:
    """Return the energy score `(...)` of samples `(M, ..., D)` for `truth (..., D)`, in their unit; smaller is better.

    Of one sample it is the error itself, so that it compares a spread with a single guess.

    Source: T. Gneiting, A. Raftery, "Strictly Proper Scoring Rules, Prediction, and Estimation", JASA 102(477),
    2007, section 4.3, with the unbiased mean over distinct pairs.
    """
    samples = np.asarray(samples, np.float64)
    count = len(samples)
    score = np.linalg.norm(samples - np.asarray(truth, np.float64), axis=-1).mean(0)
    if count == 1:
        return score
    spread = sum(np.linalg.norm(samples - sample, axis=-1).sum(0) for sample in samples)
    return score - spread / (2 * count * (count - 1))


def f1(predicted: NDArray, truth: NDArray) -> dict[str, float | None]:
    """Return precision, recall and F1 of flags; None where nothing was predicted, true, or either."""
    predicted, truth = np.asarray(predicted, bool), np.asarray(truth, bool)
    hits, predicted_count, true_count = (int(v.sum()) for v in (predicted & truth, predicted, truth))
    return {
        "precision": hits / predicted_count if predicted_count else None,
        "recall": hits / true_count if true_count else None,
        "f1": 2 * hits / (predicted_count + true_count) if predicted_count + true_count else None,
    }


def auroc(scores: NDArray, truth: NDArray) -> float | None:
    """Return the area under the ROC curve of scores `(N,)` for flags `(N,)`; None where the flags are all alike.

    It is the probability that a true one has a higher score than a false one, ties counting half: (R - n (n + 1) / 2)
    / (n m) of n true and m false ones, R the sum of the true ones' ranks, where equal scores share their mean rank.

    Source: J. A. Hanley, B. J. McNeil, "The meaning and use of the area under a ROC curve", Radiology 143 (1982),
    from the Wilcoxon statistic.
    """
    truth = np.asarray(truth, bool)
    true_count = int(truth.sum())
    false_count = truth.size - true_count
    if not true_count or not false_count:
        return None
    _, place, counts = np.unique(np.asarray(scores, np.float64), return_inverse=True, return_counts=True)
    mean_rank = np.cumsum(counts) - (counts - 1) / 2
    rank_sum = float(mean_rank[place.reshape(-1)][truth.reshape(-1)].sum())
    return (rank_sum - true_count * (true_count + 1) / 2) / (true_count * false_count)
