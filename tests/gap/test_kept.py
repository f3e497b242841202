"""What was simulated is read back as it was written, or not at all."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from candata.gap.run import cache

ARRAYS = {
    "raw": np.arange(24.0).reshape(2, 3, 4),
    "flag": np.array([True, False]),
    "empty": np.zeros((0, 3), np.float32),
}


@pytest.fixture
def file(tmp_path):
    cache.keep(tmp_path / "set" / "a.npz", **ARRAYS)
    return tmp_path / "set" / "a.npz"


def test_arrays_come_back(file):
    arrays = cache.read(file)
    assert arrays is not None
    assert arrays.keys() == ARRAYS.keys()
    for name, values in ARRAYS.items():
        assert arrays[name].dtype == values.dtype
        np.testing.assert_array_equal(arrays[name], values)


def test_any_damaged_bit_is_a_miss(file):
    """A bit of every byte, and every bit of the first fields of the archive, of its last ones, and of the digest."""
    good = file.read_bytes()
    size, ends = len(good), 64
    bits = {8 * index + index % 8 for index in range(size)}
    bits |= set(range(8 * ends)) | set(range(8 * (size - ends), 8 * size))
    for index in sorted(bits):
        bad = bytearray(good)
        bad[index // 8] ^= 1 << index % 8
        file.write_bytes(bad)
        assert cache.read(file) is None


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_cut_file_is_a_miss(file, share):
    good = file.read_bytes()
    file.write_bytes(good[: int(share * len(good))])
    assert cache.read(file) is None


def test_files_of_others_are_misses(tmp_path):
    np.savez(tmp_path / "plain.npz", **ARRAYS)
    np.savez(tmp_path / "objects.npz", raw=np.array([{}], object), sha256=np.zeros(32, np.uint8))
    np.save(tmp_path / "one.npy", ARRAYS["raw"])
    (tmp_path / "text.npz").write_text("version https://git-lfs.github.com/spec/v1\n")
    for name in ("plain.npz", "objects.npz", "one.npy", "text.npz", "missing.npz", "."):
        assert cache.read(tmp_path / name) is None


def test_sets_dated_by_a_clock_that_was_set_back_go_too(tmp_path, monkeypatch):
    for name, age_s in (("old", 86_400.0), ("in-use", 60.0), ("future", -3e7)):
        cache.keep(tmp_path / "signatures" / name / "x.npz", residual=np.zeros(1000))
        stamp = time.time() - age_s
        os.utime(tmp_path / "signatures" / name, (stamp, stamp))
    monkeypatch.setattr(cache, "LIMIT_BYTES", 1000)
    cache.prune(tmp_path)
    assert [path.name for path in (tmp_path / "signatures").iterdir()] == ["in-use"]
