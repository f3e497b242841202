"""Datasets: immutable parts and versions on disk; open, iterate, append, verify."""

from candata.datasets.adding import append, write_parts
from candata.datasets.clouds import get_cloud, put_cloud
from candata.datasets.compact import Compaction, compact_dataset
from candata.datasets.dataset import Dataset, open_dataset
from candata.datasets.encode import RawEpisode, content_hash
from candata.datasets.gc import Collection, collect_garbage
from candata.datasets.parts import RawPart, write_part
from candata.datasets.versions import create_dataset, pending_parts, publish

__all__ = [
    "Collection",
    "Compaction",
    "Dataset",
    "RawEpisode",
    "RawPart",
    "append",
    "collect_garbage",
    "compact_dataset",
    "content_hash",
    "create_dataset",
    "get_cloud",
    "open_dataset",
    "pending_parts",
    "publish",
    "put_cloud",
    "write_part",
    "write_parts",
]
