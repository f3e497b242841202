"""A small recording of a two-joint, two-fingertip hand, and writers of it in each kind of table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
import yaml

ROWS = 6
CHANNELS = {
    "object_pose": ["px", "py", "pz", "qw", "qx", "qy", "qz"],
    "joint_position": ["q_thumb_bend", "q_index1"],
    "action": ["a_thumb_bend", "a_index1"],
    "fingertip_force": [["f0_x", "f0_y", "f0_z"], ["f1_x", "f1_y", "f1_z"]],
}


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    """Two episodes of three rows each, at 100 Hz."""
    rng = np.random.default_rng(7)
    names = [c for entry in CHANNELS.values() for e in entry for c in (e if isinstance(e, list) else [e])]
    made = {"episode": np.repeat([4, 2], 3), "t": np.tile([0.0, 0.01, 0.02], 2)}
    made |= {name: rng.normal(size=ROWS) for name in names}
    made |= {name: np.full(ROWS, float(name == "qw")) for name in ("qw", "qx", "qy", "qz")}
    return made


@pytest.fixture
def write(tmp_path):
    """Write columns as a table and a map beside it; return the map's path."""

    def written(columns: dict[str, np.ndarray], kind: str = "parquet", **changed) -> Path:
        path = tmp_path / f"run.{kind}"
        if kind == "npz":
            np.savez(path, **columns)
        elif kind == "csv":
            pa.csv.write_csv(pa.table(columns), path)
        else:
            pa.parquet.write_table(pa.table(columns), path)
        mapping = {"file": path.name, "episode": "episode", "time_s": "t", "rate_hz": 100}
        mapping |= {"channels": CHANNELS} | changed
        text = yaml.safe_dump({key: value for key, value in mapping.items() if value is not None}, sort_keys=False)
        (tmp_path / "map.yaml").write_text(text)
        return tmp_path / "map.yaml"

    return written
