"""Taxels lie in a Zarr store of their part; what has none lies as before."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import zarr

from candata.checks import check
from candata.datasets import append, content_hash, create_dataset, dense, open_dataset, write_part
from candata.datasets.summary import summarise
from candata.errors import DataError
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from tests.conftest import WHOLE

LINEAGE = Lineage(operation="test")


def touched(name: str, rows: int, seed: int = 0, scale: float = 0.1) -> Episode:
    """An episode with two fingertips of four taxels."""
    rng = np.random.default_rng(seed)
    arrays = {
        "time_ns": np.arange(rows) * 12_000_000,
        "joint_position": rng.normal(size=(rows, 2)),
        "taxels": rng.integers(-128, 256, (rows, 2, 4, 3)).astype(np.int16),
        "taxels_valid": rng.random(rows) > 0.1,
    }
    return Episode(EpisodeMeta(id=name, source="real", rate_hz=83, newton_per_count=scale), arrays)


def only(root: Path, pattern: str) -> Path:
    (path,) = root.glob(pattern)
    return path


@pytest.mark.parametrize("rows", [[1], [2999, 1, 40], [3000], [5, 3000, 2995], [7000, 10]])
def test_every_count_comes_back_whatever_the_shards(tmp_path, rows):
    written = [touched(f"e{i}", n, seed=i) for i, n in enumerate(rows)]
    append(create_dataset(tmp_path / "ds"), written, LINEAGE)
    dataset = open_dataset(tmp_path / "ds")
    assert len(dataset.file.parts) == 1
    for episode, original in zip(dataset, written, strict=True):
        assert np.array_equal(episode["taxels"], original["taxels"])
        assert episode["taxels"].dtype == np.int16
        assert content_hash(episode) == content_hash(original)
    assert np.array_equal(dataset.episode(f"e{len(rows) - 1}")["taxels"], written[-1]["taxels"])
    assert check(dataset, rules=WHOLE, deep=True) == ()


def test_the_store_reads_without_candata(tmp_path):
    written = [touched("a", 2000), touched("b", 1500, seed=1, scale=0.05)]
    append(create_dataset(tmp_path / "ds"), written, LINEAGE)
    array = zarr.open_array(only(tmp_path / "ds", "parts/*/taxels.zarr"), mode="r")
    assert array.metadata.zarr_format == 3
    assert (array.dtype, array.shape) == (np.int16, (3500, 2, 4, 3))
    assert (array.chunks, array.shards) == ((75, 2, 4, 3), (3000, 2, 4, 3))
    assert "'zstd'" in str(array.metadata.to_dict()["codecs"])
    assert array.attrs["episodes"] == [
        {"id": "a", "first_row": 0, "rows": 2000, "newton_per_count": 0.1},
        {"id": "b", "first_row": 2000, "rows": 1500, "newton_per_count": 0.05},
    ]
    assert np.array_equal(array[2000:], written[1]["taxels"])


def test_the_manifest_names_every_file_of_the_store(tmp_path):
    part = write_part(create_dataset(tmp_path / "ds"), [touched("a", 3100)], {})
    folder = tmp_path / "ds" / "parts" / part.id
    stored = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()} - {"part.json"}
    assert {entry.path for entry in part.files} == stored
    assert {"taxels.zarr/zarr.json", "taxels.zarr/c/0/0/0/0", "taxels.zarr/c/1/0/0/0"} <= stored
    for entry in part.files:
        assert (folder / entry.path).stat().st_size == entry.bytes


def test_episodes_without_taxels_lie_as_before(tmp_path, episode):
    part = write_part(create_dataset(tmp_path / "ds"), [episode("a")], {})
    folder = tmp_path / "ds" / "parts" / part.id
    assert [entry.path for entry in part.files] == ["steps.parquet", "episodes.parquet"]
    assert {p.name for p in folder.iterdir()} == {"steps.parquet", "episodes.parquet", "part.json"}
    # The hash before taxels were known: stored data must keep its name.
    assert part.episodes[0][1] == "e01d2a2f2e1ad12c057b8c5951be4d3ef114a2cc05ae9e055ced7a21f8c422f5"


def test_the_content_hash_covers_taxels_and_their_scale():
    base, hashes = touched("a", 30), set()
    counts = base["taxels"].copy()
    counts[-1, -1, -1, -1] ^= 1
    for meta, arrays in (
        (base.meta, base.arrays),
        (base.meta, {**base.arrays, "taxels": counts}),
        (base.meta.model_copy(update={"newton_per_count": 0.05}), base.arrays),
    ):
        hashes.add(content_hash(Episode(meta, arrays)))
    assert len(hashes) == 3


@pytest.mark.parametrize("damage", ["missing shard", "missing store file", "truncated", "flipped", "swapped"])
def test_damage_is_found_and_named(tmp_path, damage):
    root = create_dataset(tmp_path / "ds")
    append(root, [touched("a", 3100)], LINEAGE)
    shard, head = only(root, "parts/*/taxels.zarr/c/0/0/0/0"), only(root, "parts/*/taxels.zarr/zarr.json")
    data = shard.read_bytes()
    if damage == "missing shard":
        shard.unlink()
    elif damage == "missing store file":
        head.unlink()
    elif damage == "truncated":
        shard.write_bytes(data[:-7])
    elif damage == "flipped":
        shard.write_bytes(data[:1000] + bytes([data[1000] ^ 0xFF]) + data[1001:])
    else:
        head.write_text(head.read_text().replace('"int16"', '"uint8"'))
    findings = check(open_dataset(root, partial=True), rules=WHOLE, deep=True)
    assert any("taxels.zarr" in f.message for f in findings if f.rule == "hashes")
    with pytest.raises(DataError, match=r"taxels\.zarr|content"):
        open_dataset(root).episode("a")


def test_no_flipped_byte_is_read_as_counts(tmp_path):
    root = create_dataset(tmp_path / "ds")
    original = touched("a", 200)
    append(root, [original], LINEAGE)
    for path in (only(root, "parts/*/taxels.zarr/c/0/0/0/0"), only(root, "parts/*/taxels.zarr/zarr.json")):
        data, refused = path.read_bytes(), 0
        for place in range(0, len(data), max(1, len(data) // 25)):
            path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
            try:
                assert np.array_equal(open_dataset(root).episode("a")["taxels"], original["taxels"])
            except DataError:
                refused += 1
        path.write_bytes(data)
        assert refused > 5  # others hit names and levels that decoding does not need


def test_inspect_says_range_and_unit(tmp_path):
    append(create_dataset(tmp_path / "ds"), [touched("a", 300)], LINEAGE)
    (row,) = [c for c in summarise(open_dataset(tmp_path / "ds")).channels if c.name == "taxels"]
    assert (row.unit, row.shapes) == ("count", ((2, 4, 3),))
    assert -128 <= row.low < row.high <= 255


@pytest.mark.parametrize(
    ("values", "found"),
    [
        (np.full((5, 1, 2, 3), 0.5), "float64"),
        (np.full((5, 1, 2, 3), 40_000), "from 40000 to 40000"),
        (np.full((5, 1, 2), 1), r"\(5, 1, 2\)"),
    ],
)
def test_what_are_no_counts_is_refused(values, found):
    arrays = {"time_ns": np.arange(5), "joint_position": np.zeros((5, 1)), "taxels": values}
    with pytest.raises(DataError, match=found):
        Episode(EpisodeMeta(id="a", source="real", rate_hz=80), arrays)


def test_a_part_without_taxels_does_not_load_zarr():
    code = "import sys, candata.datasets; sys.exit('zarr' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_kill_before_the_manifest_leaves_no_part(tmp_path, monkeypatch):
    root = create_dataset(tmp_path / "ds")

    def stop(_folder):
        raise KeyboardInterrupt

    monkeypatch.setattr(dense, "files", stop)
    with pytest.raises(KeyboardInterrupt):
        write_part(root, [touched("a", 3100)], {})
    assert not (root / "parts").exists()
    assert json.loads((root / "dataset.json").read_text())["schema_channels"][-1]["name"] == "taxels"
