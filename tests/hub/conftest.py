"""A stand-in Hub, datasets, and the command line that talks to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.formats import Writing
from candata.formats.lerobot import FORMAT
from candata.schema.manifest import Lineage
from tests.conftest import make_episode
from tests.hub.stand_in import Repository, StandInHub


@pytest.fixture
def hub(monkeypatch, tmp_path) -> Iterator[StandInHub]:
    """A Hub without any data set; nobody is logged in."""
    server = StandInHub()
    monkeypatch.setenv("HF_ENDPOINT", server.url)
    monkeypatch.delenv("HF_TOKEN", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture
def dataset(tmp_path) -> Callable[..., Path]:
    """Makes a dataset of small episodes: `dataset("ab")`."""

    def make(ids: str, name: str = "cups", **details: object) -> Path:
        root = create_dataset(tmp_path / name)
        episodes = [make_episode(i, seed=ord(i), task="lift", actuator_names=()) for i in ids]
        append(root, episodes, Lineage(operation="recorded", details=details))
        return root

    return make


@pytest.fixture
def published(hub, dataset, tmp_path) -> Callable[..., Repository]:
    """Puts a LeRobot set with a video on the Hub: `published("acme/cups", "ab")`."""

    def publish(name: str, ids: str = "ab", **fields: object) -> Repository:
        data = open_dataset(dataset(ids, name=f"{name.split('/')[1]}-{ids}"))
        folder = tmp_path / f"export-{ids}"
        folder.mkdir()
        FORMAT.write(data, folder, Writing(data.name, data.digest, data.lineage))
        files = {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
        repository = hub.repositories.setdefault(name, Repository(**fields))
        repository.commit(files | {"videos/cam/episode_0.mp4": b"film" * 1000, "README.md": b"# cups"})
        return repository

    return publish


def content(path: Path) -> dict[str, list[np.ndarray]]:
    """Return all arrays of a dataset by episode."""
    return {e.meta.id: list(e.arrays.values()) for e in open_dataset(path)}
