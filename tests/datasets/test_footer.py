"""Claims of Parquet files are read as pyarrow reads them, and a damaged footer is an error instead of the end."""

from __future__ import annotations

import contextlib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from candata.datasets.bounded import read_parquet
from candata.datasets.footer import read_chunks


@pytest.fixture
def file(tmp_path):
    """Two row groups of numbers, lists, texts and truth values, with what pyarrow says of itself."""
    columns = {"number": np.arange(10), "list": [[1.0, 2.0]] * 10, "text": ["a", "b"] * 5, "flag": [True, False] * 5}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet", row_group_size=6)
    return tmp_path / "a.parquet"


def test_claims_are_those_that_pyarrow_reads(file):
    metadata = pq.read_metadata(file)
    for index, chunks in enumerate(read_chunks(file)):
        group = metadata.row_group(index)
        columns = [group.column(k) for k in range(group.num_columns)]
        told = [(c.path_in_schema, group.num_rows, c.num_values, c.total_uncompressed_size) for c in columns]
        assert [tuple(chunk) for chunk in chunks] == told


def test_a_histogram_that_does_not_fit_ends_in_an_error(file):
    """pyarrow 26.0.1 ends the process when its metadata is asked for such a chunk."""
    data = bytearray(file.read_bytes())
    histogram = bytes([0x19, 0x06 | 2 << 4])  # a list of two i64: how many values are at each definition level
    length = int.from_bytes(data[-8:-4], "little")
    place = data.rindex(histogram, len(data) - 8 - length)
    data[place + 1] = 0x06 | 3 << 4
    data.insert(place + 2, 0)
    data[-8:-4] = (length + 1).to_bytes(4, "little")
    file.write_bytes(data)
    with pytest.raises((OSError, ValueError, pa.ArrowException)):
        read_parquet(file)


@pytest.mark.parametrize("cut", [0, 3, 8, 20])
def test_a_file_without_its_footer_is_none(file, cut):
    file.write_bytes(file.read_bytes()[:cut])
    with pytest.raises(ValueError, match="its footer is missing"):
        read_chunks(file)


def test_any_footer_is_read_or_refused(file, rng):
    data = file.read_bytes()
    length = int.from_bytes(data[-8:-4], "little")
    for _ in range(500):
        footer = bytearray(data[-8 - length : -8])
        for place in rng.integers(0, length, 3):
            footer[place] = rng.integers(0, 256)
        file.write_bytes(data[: -8 - length] + footer + data[-8:])
        with contextlib.suppress(ValueError):
            assert all(chunk.column for group in read_chunks(file) for chunk in group)
