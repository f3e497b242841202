"""Datasets and remotes for the tests of the registry."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset, put_cloud
from candata.datasets.remotes import open_remote
from candata.datasets.store import Store
from candata.datasets.tagging import set_tag
from candata.loaders.splits import make_split, save_split
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from candata.schema.registry import RemoteEntry

from ..conftest import make_episode

BUCKET = "bucket"


@pytest.fixture
def dataset(tmp_path, episode) -> Callable[..., Path]:
    """Makes a dataset of small episodes: `dataset("a", ids)`; each id has its own content."""

    def make(name: str, ids: str = "abcd", part_size: int = 2, **meta: object) -> Path:
        root = create_dataset(tmp_path / name)
        add(root, [episode(i, seed=ord(i), **meta) for i in ids], part_size)
        return root

    return make


def add(root: Path, episodes: list[Episode], part_size: int = 2) -> None:
    """Append episodes as one version."""
    append(root, episodes, Lineage(operation="test", seeds=(7,), details={"scene": "table"}), part_size)


@pytest.fixture(scope="session")
def rich_once(tmp_path_factory) -> Path:
    """What `rich` is a copy of."""
    root = create_dataset(tmp_path_factory.mktemp("rich") / "rich")
    add(root, [make_episode(i, seed=ord(i)) for i in "abcd"])
    cloud = put_cloud(root, np.eye(3))
    base = make_episode("t", seed=1, point_cloud=cloud, newton_per_count=0.1)
    taxels = np.arange(len(base) * 2 * 120 * 3, dtype=np.int16).reshape(len(base), 2, 120, 3)
    add(root, [Episode(base.meta, {**base.arrays, "taxels": taxels})])
    opened = open_dataset(root)
    save_split(opened, make_split(opened, seed=3))
    set_tag(root, "clean")
    return root


@pytest.fixture
def rich(rich_once, tmp_path) -> Path:
    """A dataset with two versions, a point cloud, taxels, a split and a tag."""
    return shutil.copytree(rich_once, tmp_path / "rich")


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """The address of an S3 server on loopback, with a bucket."""
    moto = pytest.importorskip("moto.server")
    import boto3

    logging.getLogger("werkzeug").setLevel(logging.CRITICAL)
    server = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    url = f"http://{host}:{port}"
    keys = {"aws_access_key_id": "test", "aws_secret_access_key": "test", "region_name": "us-east-1"}
    boto3.client("s3", endpoint_url=url, **keys).create_bucket(Bucket=BUCKET)
    yield url
    server.stop()


@pytest.fixture(params=["folder", "s3"])
def entry(request, tmp_path, monkeypatch) -> RemoteEntry:
    """A remote: once a folder, once a prefix of its own on a real S3 server."""
    if request.param == "folder":
        (tmp_path / "share").mkdir()
        return RemoteEntry(url=str(tmp_path / "share"))
    return s3_entry(request.getfixturevalue("s3_server"), monkeypatch, tmp_path.name)


def s3_entry(server: str, monkeypatch: pytest.MonkeyPatch, prefix: str) -> RemoteEntry:
    """A remote on the S3 server; its credentials are in the environment."""
    pytest.importorskip("obstore")
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "test")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "test")
    return RemoteEntry(url=f"s3://{BUCKET}/{prefix}", endpoint=server, allow_http=True)


@pytest.fixture
def store(entry) -> Store:
    """The store behind the remote."""
    return open_remote(entry)
