"""Appends single-episode parts for ever; prints `id hash` once each is published."""

from __future__ import annotations

import itertools
import sys

import numpy as np

from candata.datasets import append, content_hash
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage


def main(root: str, name: str) -> None:
    rng = np.random.default_rng(list(name.encode()))
    for number in itertools.count():
        arrays = {"time_ns": np.arange(50) * 12_500_000, "joint_position": rng.normal(size=(50, 15))}
        episode = Episode(EpisodeMeta(id=f"{name}-{number:04d}", source="sim", rate_hz=80), arrays)
        append(root, [episode], Lineage(operation="kill test"))
        print(episode.meta.id, content_hash(episode), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
