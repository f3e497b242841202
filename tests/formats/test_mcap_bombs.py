"""Small recordings that unfold to more than a machine holds: one clear error or damage, within 1 GB of memory."""

from __future__ import annotations

import struct
from pathlib import Path

import pyarrow as pa
import pytest
import zstandard

from candata.formats._mcap_scan import MAGIC
from tests.memory import GIGABYTE, memory_and_words

pytestmark = pytest.mark.hard

#: Scans a file and keeps every record, as the readers of recordings do.
SCAN = """
import sys
from pathlib import Path
from candata.errors import CandataError
from candata.formats._mcap_scan import Scan

scan, kept = Scan(Path(sys.argv[1])), []
try:
    kept.extend(scan)
except CandataError as error:
    print(error)
print(len(kept), scan.damaged_chunks)
"""
#: The smallest message there is: 22 bytes and none of its own.
MESSAGE = struct.pack("<BQ", 5, 22) + struct.pack("<HIQQ", 1, 0, 0, 0)


def chunk(packed: bytes, size: int, compression: str = "zstd") -> bytes:
    name = compression.encode()
    head = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(name)) + name
    body = head + struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_many_chunks_of_the_smallest_messages(tmp_path: Path, compression):
    body = MESSAGE * 300_000
    one = chunk(pa.Codec(compression).compress(body, asbytes=True), len(body), compression)
    (tmp_path / "bomb.mcap").write_bytes(MAGIC + one * 100)
    assert (tmp_path / "bomb.mcap").stat().st_size < 5_000_000
    peak, said = memory_and_words(SCAN, tmp_path / "bomb.mcap")
    assert peak < GIGABYTE
    assert said.startswith("a file unfolds to more than is read at once\n  expected: at most 537 MB of ")


@pytest.mark.parametrize("claimed", [1000, 2**20, 2 * GIGABYTE, 2**63])
def test_a_chunk_that_holds_more_than_it_says_or_than_any_chunk(tmp_path: Path, claimed):
    block, packer = bytes(2**20), zstandard.ZstdCompressor().compressobj(size=2 * GIGABYTE)
    packed = b"".join(packer.compress(block) for _ in range(2048)) + packer.flush()
    sound = chunk(MESSAGE, len(MESSAGE), "")
    (tmp_path / "bomb.mcap").write_bytes(MAGIC + sound + chunk(packed, claimed) + sound)
    peak, said = memory_and_words(SCAN, tmp_path / "bomb.mcap")
    assert peak < GIGABYTE / 2
    assert said == "2 1"  # what stands before and behind it is read
