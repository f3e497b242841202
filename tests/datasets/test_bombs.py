"""Small files that unfold to more than a machine holds: one clear error, and never more than 1 GB of memory."""

from __future__ import annotations

import json
from pathlib import Path

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard

from candata.datasets import append, create_dataset, put_cloud
from candata.datasets.clouds import cloud_path
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from tests.memory import GIGABYTE, memory_and_words

from .forging import forge, lay

pytestmark = pytest.mark.hard

#: Reads a dataset whole, as `candata validate` does, or pulls one.
READ = """
import sys
from candata.datasets import get_cloud, open_dataset
from candata.errors import CandataError
from candata.datasets.pull import pull
from candata.datasets.remotes import open_remote
from candata.schema.registry import RemoteEntry

verb, place, *rest = sys.argv[1:]
try:
    if verb == "pull":
        pull(open_remote(RemoteEntry(url=place)), "x", rest[0])
    elif verb == "cloud":
        get_cloud(place, rest[0])
    else:
        data = open_dataset(place)
        data.catalog()
        for part in data.raw_parts():
            for episode in part.episodes():
                pass
    print("read")
except CandataError as error:
    print(error)
"""


def repeated(value: object, count: int, kind: pa.DataType) -> pa.DictionaryArray:
    """A value held once and named so often: in Parquet, a few bytes."""
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, np.int32)), pa.array([value], kind))


def rows_without_end(folder: Path, _: dict) -> None:
    """Forty million rows of one number, which the tables agree on."""
    count = 40_000_000
    schema = pq.read_schema(folder / "steps.parquet")
    kept = {b"candata.layout": json.dumps({"time_ns": [], "contact": []}).encode()}
    zeros = pa.array(np.zeros(count, np.int64))
    columns = {"episode": repeated("a", count, pa.string()), "time_ns": zeros, "contact": zeros.cast(pa.bool_())}
    assert set(columns) <= set(schema.names)
    table = pa.table(columns).replace_schema_metadata(kept)
    pq.write_table(table, folder / "steps.parquet", row_group_size=count, compression="zstd")
    catalog = pq.read_table(folder / "episodes.parquet", partitioning=None)
    index = catalog.schema.get_field_index("rows")
    pq.write_table(catalog.set_column(index, "rows", pa.array([count])), folder / "episodes.parquet")


def text_without_end(folder: Path, _: dict) -> None:
    """Ten thousand episodes that share one record of a megabyte."""
    _catalog(folder, meta=repeated("x" * 1_000_000, 10_000, pa.string()))


def names_without_end(folder: Path, _: dict) -> None:
    """An episode with ten million joints of a hundred letters."""
    count = 10_000_000
    joints = repeated("j" * 100, count, pa.string())
    _catalog(folder, joint_names=pa.ListArray.from_arrays(pa.array([0, count], pa.int32()), joints))


def _catalog(folder: Path, **columns: pa.Array) -> None:
    """Write a catalog with these columns, the others as in its first row."""
    first = pq.read_table(folder / "episodes.parquet", partitioning=None).slice(0, 1)
    (count,) = {len(column) for column in columns.values()}
    for name in first.column_names:
        if name not in columns and not pa.types.is_list(first[name].type) and first[name][0].is_valid:
            columns[name] = repeated(first[name][0].as_py(), count, first[name].type)
    pq.write_table(pa.table(columns), folder / "episodes.parquet", compression="zstd")


@pytest.fixture
def root(tmp_path, episode) -> Path:
    """A dataset of one episode."""
    path = create_dataset(tmp_path / "ds")
    append(path, [episode("a")], Lineage(operation="test"))
    return path


@pytest.mark.parametrize("bomb", [rows_without_end, text_without_end, names_without_end])
def test_a_table_that_unfolds_without_end(root, tmp_path, bomb):
    forge(root, bomb)
    size = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
    assert size < 2_000_000
    peak, said = memory_and_words(READ, "read", root)
    assert peak < GIGABYTE
    assert said.startswith("a file unfolds to more than is read at once\n  expected: at most 537 MB of ")
    lay(root, tmp_path / "share", "x")
    peak, said = memory_and_words(READ, "pull", tmp_path / "share", tmp_path / "out")
    assert peak < GIGABYTE
    assert "the remote is damaged" in said
    assert not (tmp_path / "out").exists()


def taxels(rows: int) -> Episode:
    """An episode with one fingertip of one taxel."""
    arrays = {
        "time_ns": np.arange(rows) * 12_000_000,
        "joint_position": np.zeros((rows, 2)),
        "taxels": np.ones((rows, 1, 1, 3), np.int16),
    }
    return Episode(EpisodeMeta(id="a", source="real", rate_hz=83, newton_per_count=0.1), arrays)


def chunk_without_end(folder: Path, _: dict) -> None:
    """A chunk of 450 bytes whose compressed form holds two gigabytes."""
    shard = folder / "taxels.zarr/c/0/0/0/0"
    places = np.full((40, 2), 2**64 - 1, "<u8")
    block, packer = bytes(2**20), zstandard.ZstdCompressor().compressobj(size=2 * GIGABYTE)
    packed = b"".join(packer.compress(block) for _ in range(2048)) + packer.flush()
    places[0] = 0, len(packed)
    index = places.tobytes()
    shard.write_bytes(packed + index + google_crc32c.value(index).to_bytes(4, "little"))


def rows_of_taxels_without_end(folder: Path, _: dict) -> None:
    """A store that says it is wide, and holds nothing."""
    head = folder / "taxels.zarr/zarr.json"
    text = json.loads(head.read_text())
    wide = 100_000_000
    text["shape"][1] = wide
    text["chunk_grid"]["configuration"]["chunk_shape"][1] = wide
    text["codecs"][0]["configuration"]["chunk_shape"][1] = wide
    head.write_text(json.dumps(text))
    (folder / "taxels.zarr/c/0/0/0/0").write_bytes(b"")
    steps = pq.read_table(folder / "steps.parquet", partitioning=None)
    layout = json.loads(steps.schema.metadata[b"candata.layout"]) | {"taxels": [wide, 1, 3]}
    pq.write_table(
        steps.replace_schema_metadata({b"candata.layout": json.dumps(layout).encode()}), folder / "steps.parquet"
    )


@pytest.mark.parametrize("bomb", [chunk_without_end, rows_of_taxels_without_end])
def test_a_store_that_unfolds_without_end(tmp_path, bomb):
    root = create_dataset(tmp_path / "ds")
    append(root, [taxels(20)], Lineage(operation="test"))
    forge(root, bomb)
    peak, said = memory_and_words(READ, "read", root)
    assert peak < GIGABYTE
    assert "taxels.zarr" in said
    assert said != "read"


def test_a_cloud_that_unfolds_without_end(root):
    sha = put_cloud(root, np.eye(3))
    zeros = repeated(0.0, 30_000_000, pa.float32())
    pq.write_table(pa.table({axis: zeros for axis in "xyz"}), cloud_path(root, sha), compression="zstd")
    peak, said = memory_and_words(READ, "cloud", root, sha)
    assert peak < GIGABYTE
    assert "a file unfolds to more than is read at once" in said
