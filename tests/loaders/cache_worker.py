"""Opens the cache of a dataset, slowly; prints `building` on the way and the sum of a column at the end.

A second argument is how long it stays in the middle of building [s].
"""

from __future__ import annotations

import sys
import time

import numpy as np

from candata.datasets import open_dataset
from candata.loaders import open_cache


def report(done: int, total: int) -> None:
    if done == 2:
        print("building", flush=True)
        time.sleep(float(sys.argv[2]) if len(sys.argv) > 2 else 0.0)
    time.sleep(0.01)


def main(root: str) -> None:
    cache = open_cache(open_dataset(root), progress=report)
    print(float(cache.rows["joint_position"][:, 0].sum(dtype=np.float64)))


if __name__ == "__main__":
    main(sys.argv[1])
