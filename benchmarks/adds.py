"""Poses scored by ADD-S a second, against brute force over all pairs of points.

Ours finds the nearest points by matrix products (k-d trees took half as long again). Both score the same pairs of
poses of one cloud, a few centimetres and some degrees apart, and take turns in one run, so that a busy machine slows
both. The largest difference of their values is printed beside.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np
from scipy.spatial.distance import cdist

from candata.rotation import exp, multiply, normalise, rotate
from candata.training.metrics import adds

TARGET, EXACT_M = 5.0, 2e-9


def pairs(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return true poses, and forecast ones about 2 cm and 10 degrees away."""
    truth = np.concatenate([rng.normal(0, 0.2, (count, 3)), normalise(rng.normal(size=(count, 4)))], axis=1)
    turned = multiply(exp(rng.normal(0, 0.1, (count, 3))), truth[:, 3:])
    return truth, np.concatenate([truth[:, :3] + rng.normal(0, 0.012, (count, 3)), turned], axis=1)


def brute(cloud: np.ndarray, predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return ADD-S of each pair by all distances."""
    placed = ([rotate(p[3:], cloud) + p[:3] for p in pair] for pair in zip(truth, predicted, strict=True))
    return np.array([cdist(*two).min(1).mean() for two in placed])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=512)
    parser.add_argument("--poses", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=5)
    asked = parser.parse_args()
    rng = np.random.default_rng(0)
    # The surface of a can, as in `xhand_tabletop`.
    angle, height = rng.uniform(0, 2 * np.pi, asked.points), rng.uniform(-0.06, 0.06, asked.points)
    cloud = np.stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), height], axis=1)
    ratios, apart = [], 0.0
    for _ in range(asked.rounds):
        truth, predicted = pairs(asked.poses, rng)
        start = time.process_time()
        fast = adds(cloud, predicted, truth)
        middle = time.process_time()
        slow = brute(cloud, predicted, truth)
        fast_s, slow_s = middle - start, time.process_time() - middle
        ratios.append(slow_s / fast_s)
        apart = max(apart, float(np.abs(fast - slow).max()))
        print(f"candata {1e6 * fast_s / asked.poses:.0f} us a pose, brute force {1e6 * slow_s / asked.poses:.0f} us")
    print(
        f"ADD-S over brute force, {asked.points} points: median {statistics.median(ratios):.1f}, target >= {TARGET:g}"
    )
    print(f"largest difference {apart:.1e} m, target <= {EXACT_M:.0e} m")


if __name__ == "__main__":
    main()
