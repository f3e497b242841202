"""Filtering a catalog of 100,000 episodes, beside plain pyarrow in the same run; target and result side by side.

    python benchmarks/registry.py

The catalog is synthetic and lies in a file, as one of a dataset does. Time is CPU time of the process on one thread.
Needs the extra `query`.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from candata.datasets import encode
from candata.datasets.filtering import COLUMNS, select

EPISODES, ROUNDS, TARGET_S = 100_000, 9, 0.1
WHERE = "object = 'cup' and rows > 200 and seed < 50000"


def catalog(count: int) -> pa.Table:
    """Return a catalog as datasets keep it."""
    rng = np.random.default_rng(0)
    names = [["thumb", "index", "middle"]] * count
    columns = {
        "id": [f"e{i:06d}" for i in range(count)],
        "source": ["sim", "real"] * (count // 2),
        "scene": ["table"] * count,
        "object": rng.choice(["cup", "can", "box"], count),
        "task": ["pick"] * count,
        "seed": np.arange(count),
        "effects": ['[{"name": "joint_damping"}]'] * count,
        "outcome": [None] * count,
        "rate_hz": np.full(count, 80.0),
        "rows": rng.integers(100, 400, count),
        "duration_s": rng.random(count),
        "joint_names": names,
        "actuator_names": names,
        "fingertip_names": names,
        "content_hash": [f"{i:064x}" for i in range(count)],
        "row_group": np.zeros(count, int),
        "meta": ["{}"] * count,
    }
    return pa.table({name: pa.array(columns[name], encode.EPISODE_COLUMNS.field(name).type) for name in COLUMNS})


def by_duckdb(path: Path) -> int:
    """Return how many rows the expression chooses."""
    return len(select(pq.read_table(path, columns=["id", "object", "rows", "seed"], use_threads=False), WHERE))


def by_pyarrow(path: Path) -> int:
    """Return how many rows the same condition, written by hand, chooses."""
    table = pq.read_table(path, columns=["id", "object", "rows", "seed"], use_threads=False)
    few = pc.and_(pc.greater(table["rows"], 200), pc.less(table["seed"], 50_000))
    return len(table.filter(pc.and_(pc.equal(table["object"], "cup"), few))["id"].to_pylist())


def cpu_s(call: Callable[[], int]) -> float:
    """Return the CPU seconds of one call."""
    start = time.process_time()
    call()
    return time.process_time() - start


def main() -> None:
    """Print the medians beside the target."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "catalog.parquet"
        pq.write_table(catalog(EPISODES), path, compression="zstd")
        if by_duckdb(path) != by_pyarrow(path):
            raise SystemExit("the two choose different rows")
        ways = {"candata registry filter": by_duckdb, "pyarrow by hand": by_pyarrow}
        took: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(ROUNDS):
            for name, way in ways.items():
                took[name].append(cpu_s(lambda way=way: way(path)))  # type: ignore[misc]
    found = statistics.median(took["candata registry filter"])
    print(f"{'ok  ' if found < TARGET_S else 'MISS'} filter {EPISODES} episodes: {found:.3f} s, target < {TARGET_S} s")
    by_hand = statistics.median(took["pyarrow by hand"])
    print(f"     pyarrow by hand: {by_hand:.3f} s; ratio {found / by_hand:.1f}")


if __name__ == "__main__":
    main()
