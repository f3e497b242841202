from __future__ import annotations

import numpy as np
import pytest

from candata.datasets import append, create_dataset, get_cloud, open_dataset, put_cloud
from candata.errors import DataError
from candata.schema.manifest import Lineage


@pytest.fixture
def root(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode(f"e{i}", seed=i) for i in range(3)], Lineage(operation="test"))
    return root


def only(root, pattern):
    (path,) = root.glob(pattern)
    return path


@pytest.mark.parametrize("name", ["part.json", "steps.parquet", "episodes.parquet"])
def test_a_missing_file_is_named_on_opening(root, name):
    only(root, f"parts/*/{name}").unlink()
    with pytest.raises(DataError, match=name):
        open_dataset(root)


@pytest.mark.parametrize("name", ["part.json", "steps.parquet", "episodes.parquet"])
def test_a_truncated_file_is_named_on_opening(root, name):
    path = only(root, f"parts/*/{name}")
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(DataError, match=name):
        open_dataset(root)


def outcomes(root, path, count, read):
    """Return what `read` gives, or the error's text, with one byte flipped at each of `count` places."""
    data, found = path.read_bytes(), []
    for place in range(0, len(data), max(1, len(data) // count)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        try:
            found.append(read(open_dataset(root)))
        except DataError as error:
            found.append(str(error))
    return found


def test_no_flipped_byte_is_ever_read_as_data(root):
    def read(dataset):
        return [(e.meta.id, e["joint_position"].tobytes()) for e in dataset]

    whole = read(open_dataset(root))
    found = outcomes(root, only(root, "parts/*/steps.parquet"), 40, read)
    errors = [text for text in found if text != whole]
    assert all("steps.parquet" in text for text in errors)
    assert len(errors) > 10  # the others hit bytes that carry no values: names, statistics, padding


def test_a_changed_record_is_refused(root):
    def read(dataset):
        return [e.meta for e in dataset]

    whole = read(open_dataset(root))
    found = outcomes(root, only(root, "parts/*/episodes.parquet"), 60, read)
    errors = [text for text in found if text != whole]
    assert errors
    assert all(".parquet" in text for text in errors)


def test_a_damaged_version_is_named(root):
    (root / "versions" / "000001.json").write_text("{")
    with pytest.raises(DataError, match=r"000001\.json"):
        open_dataset(root)


@pytest.mark.parametrize("partial", [False, True])
def test_a_version_of_another_digest_is_named(root, partial):
    path = root / "versions" / "000001.json"
    digest = open_dataset(root).digest
    path.write_text(path.read_text().replace(digest, "0" * 64))
    with pytest.raises(DataError, match=rf"000001\.json\n  expected: digest {digest[:12]} of its episodes") as error:
        open_dataset(root, partial=partial)
    assert error.value.found == "digest 000000000000"


def test_partial_opens_what_is_intact(root, episode):
    first = only(root, "parts/*/part.json")
    append(root, [episode("later", seed=7)], Lineage(operation="more"))
    first.unlink()
    dataset = open_dataset(root, partial=True)
    assert dataset.ids == ("later",)
    assert len(list(dataset.raw_parts())) == 2


def test_a_damaged_catalog_is_made_again(root):
    expected = open_dataset(root).catalog()
    only(root, "catalog/*.parquet").write_bytes(b"PAR1")
    assert open_dataset(root).catalog() == expected


def test_a_cloud_is_named_by_its_points(root):
    points = np.random.default_rng(0).normal(size=(8, 3)).astype(np.float32)
    name = put_cloud(root, points)
    assert put_cloud(root, points.copy()) == name
    assert np.array_equal(get_cloud(root, name), points)
    other = put_cloud(root, points + 1)
    (root / "objects" / f"{name}.parquet").write_bytes((root / "objects" / f"{other}.parquet").read_bytes())
    with pytest.raises(DataError, match=name):
        get_cloud(root, name)
    with pytest.raises(DataError, match="no such file"):
        get_cloud(root, "0" * 64)


@pytest.mark.parametrize("points", [[[1.0, 2.0]], [], [[0.0, float("nan"), 0.0]]])
def test_what_is_no_cloud_is_refused(root, points):
    with pytest.raises(DataError, match="not a point cloud"):
        put_cloud(root, points)
