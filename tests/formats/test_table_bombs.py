"""Small tables that unfold to more than is read at once: one clear error, within 1 GB of memory, nothing written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.memory import GIGABYTE, memory_and_words

pytestmark = pytest.mark.hard

IMPORT = """
import sys
from candata_cli.main import main

try:
    sys.stderr = sys.stdout
    main(["import", "table", sys.argv[1], "--out", sys.argv[2]])
except SystemExit as end:
    print("exit", end.code)
"""
MAP = """file: bomb.parquet
source: real
episode: e
time_s: t
rate_hz: 80
channels: {joint_position: [q], action: [u]}
"""


def test_a_table_of_many_equal_rows(tmp_path: Path):
    count = 20_000_000
    nowhere = pa.array(np.zeros(count, np.int8))
    zeros, names = (pa.DictionaryArray.from_arrays(nowhere, pa.array([value])) for value in (0.0, "a"))
    table = pa.table({"e": names, "t": zeros, "q": zeros, "u": zeros})
    pq.write_table(table, tmp_path / "bomb.parquet", compression="zstd", row_group_size=count)
    assert (tmp_path / "bomb.parquet").stat().st_size < 1_000_000
    (tmp_path / "map.yaml").write_text(MAP)
    peak, said = memory_and_words(IMPORT, tmp_path / "map.yaml", tmp_path / "out")
    assert peak < GIGABYTE
    assert "a file unfolds to more than is read at once\n  expected: at most 537 MB of " in said
    assert said.endswith("exit 2")
    assert not (tmp_path / "out").exists()
