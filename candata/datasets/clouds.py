"""Point clouds: one file an object, named by its content."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from candata.datasets import durable
from candata.datasets.bounded import read_parquet
from candata.datasets.versions import read_dataset_file
from candata.errors import DataError, Where


def put_cloud(path: str | Path, points: NDArray) -> str:
    """Return the sha256 that names the cloud in the dataset; the same points are kept once.

    Parameters
    ----------
    path : str or Path
        Dataset.
    points : (N, 3) float32 [m]
        Points on the object, in its frame.

    Raises
    ------
    DataError
        When the shape is wrong or a point is not finite.
    UsageError
        When there is no dataset.
    """
    root = Path(path)
    read_dataset_file(root)
    cloud = np.ascontiguousarray(points, np.float32)
    finite = bool(np.isfinite(cloud).all())
    if cloud.ndim != 2 or cloud.shape[1] != 3 or not len(cloud) or not finite:
        raise DataError(
            "not a point cloud",
            expected="finite (N, 3), N >= 1",
            found=f"{cloud.shape}, finite: {finite}",
            where=Where(path=str(root), channel="point_cloud"),
        )
    name = cloud_hash(cloud)
    target = cloud_path(root, name)
    with durable.publish_lock(root):
        if target.is_file():
            durable.touch(target)
            return name
    table = pa.table({axis: cloud[:, i] for i, axis in enumerate("xyz")})
    with durable.replacing_staged(root, target) as draft:
        pq.write_table(table, draft, compression="zstd")
    return name


def get_cloud(path: str | Path, sha: str) -> NDArray[np.float32]:
    """Return the points `(N, 3) float32 [m]` that `put_cloud` named `sha`.

    Raises
    ------
    DataError
        When the file is missing or damaged; names it.
    """
    target = cloud_path(Path(path), sha)
    try:
        table = read_parquet(target)
        cloud = np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1)
    except (pa.ArrowException, OSError, ValueError, KeyError) as error:
        raise durable.damaged_error(target, durable.reason(error)) from None
    if cloud_hash(cloud) != sha:
        raise durable.damaged_error(target, f"content {cloud_hash(cloud)[:12]}", f"content {sha[:12]}")
    return cloud


def cloud_path(root: Path, sha: str) -> Path:
    """Return the file of a cloud."""
    return root / "objects" / f"{sha}.parquet"


def cloud_hash(cloud: NDArray[np.float32]) -> str:
    """Return sha256 over (name, dtype, shape, bytes), as an episode's columns are hashed."""
    head = f"point_cloud|float32|{len(cloud)},3|".encode()
    return hashlib.sha256(head + np.ascontiguousarray(cloud, "<f4").tobytes()).hexdigest()
