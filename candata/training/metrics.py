"""Scores of forecasts: ADD-S and its AUC, energy score, F1, Wilson interval."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from candata.rotation import conjugate, multiply, rotate

Array = NDArray[np.float64]

#: Errors beyond this distance count nothing in the area under the curve.
#: Source: Y. Xiang et al., "PoseCNN", RSS 2018, section on evaluation metrics (10 cm).
ADDS_LIMIT_M = 0.1
#: A final position this near the true one is a success. Source: arXiv 2601.12796, section on evaluation.
SUCCESS_M = 0.05
#: Two-sided 95 % quantile of the standard normal distribution.
Z_95 = 1.959963984540054
#: Points of a leaf; measured: a quarter faster than the default for clouds of 512 points.
_LEAF = 16
#: Points of one query; bounds the memory of many poses at once (about 50 MB).
_POINTS_A_QUERY = 1 << 20


def cloud_trees(clouds: NDArray) -> list[KDTree]:
    """Return one static tree an object for `adds`; `clouds` is `(C, N, 3) [m]`, in the object's frame."""
    return [KDTree(np.asarray(cloud, np.float64), leafsize=_LEAF) for cloud in clouds]


def adds(tree: KDTree, predicted: NDArray, truth: NDArray) -> Array:
    """Return ADD-S `(...) [m]`: mean distance of the true cloud's points to the nearest predicted one.

    The true points are moved into the predicted frame, so that one tree serves all poses.

    Parameters
    ----------
    tree : KDTree
        Of the object's cloud, in its frame.
    predicted, truth : (..., 7)
        Poses [m, w x y z] of equal shape.

    Notes
    -----
    Source: Y. Xiang et al., "PoseCNN", RSS 2018, section on evaluation metrics (ADD-S).
    """
    predicted, truth = (np.asarray(p, np.float64) for p in (predicted, truth))
    flat, true = predicted.reshape(-1, 7), truth.reshape(-1, 7)
    back = conjugate(flat[:, 3:])
    turn, shift = multiply(back, true[:, 3:]), rotate(back, true[:, :3] - flat[:, :3])
    found = np.empty(len(flat))
    axes = rotate(turn[:, None, :], np.eye(3)[None])  # the images of x, y, z: (poses, 3, 3)
    # In the order of the tree's leaves, so that one query finds what it needs where the last one was.
    cloud, some = tree.data[tree.indices], max(1, _POINTS_A_QUERY // tree.n)
    for first in range(0, len(flat), some):
        part = slice(first, first + some)
        points = cloud @ axes[part] + shift[part, None, :]
        found[part] = tree.query(points.reshape(-1, 3))[0].reshape(-1, tree.n).mean(1)
    return found.reshape(predicted.shape[:-1])


def adds_of(trees: Sequence[KDTree], cloud: NDArray, predicted: NDArray, truth: NDArray) -> Array:
    """Return ADD-S `(B, ...) [m]` of windows whose objects are `cloud (B,)`, as indices into `trees`."""
    found = np.empty(np.shape(predicted)[:-1])
    for index in np.unique(cloud):
        of_object = np.asarray(cloud) == index
        found[of_object] = adds(trees[index], predicted[of_object], truth[of_object])
    return found


def auc(errors: NDArray, limit_m: float = ADDS_LIMIT_M) -> float:
    """Return the area under the accuracy-threshold curve up to `limit_m`, 0 to 1, exactly.

    The accuracy at threshold x is the share of errors below x; its integral over [0, limit] divided by the limit is
    the mean of max(0, 1 - e / limit). NaN for no errors.
    """
    errors = np.asarray(errors, np.float64)
    return float(np.maximum(0.0, 1 - errors / limit_m).mean()) if errors.size else math.nan


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
    spread = sum(np.linalg.norm(samples - one, axis=-1).sum(0) for one in samples)
    return score - spread / (2 * count * (count - 1))


def f1(predicted: NDArray, truth: NDArray) -> dict[str, float | None]:
    """Return precision, recall and F1 of flags; None where nothing was predicted, true, or either."""
    predicted, truth = np.asarray(predicted, bool), np.asarray(truth, bool)
    hits, said, true = (int(v.sum()) for v in (predicted & truth, predicted, truth))
    return {
        "precision": hits / said if said else None,
        "recall": hits / true if true else None,
        "f1": 2 * hits / (said + true) if said + true else None,
    }


def wilson(successes: int, total: int, z: float = Z_95) -> tuple[float, float]:
    """Return the interval `(low, high)` of a share, 95 % by default; (0, 1) for no trials.

    Source: E. B. Wilson, "Probable Inference, the Law of Succession, and Statistical Inference", JASA 22(158), 1927.
    """
    if total == 0:
        return 0.0, 1.0
    share, square = successes / total, z * z / total
    centre = (share + square / 2) / (1 + square)
    half = z / (1 + square) * math.sqrt(share * (1 - share) / total + square / (4 * total))
    return max(0.0, centre - half), min(1.0, centre + half)
