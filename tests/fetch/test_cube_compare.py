"""The example's table: means over splits, published rows, targets."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "cube_tosses" / "compare.py"


@pytest.fixture(scope="module")
def compare():
    spec = importlib.util.spec_from_file_location("compare", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def report(position_share: float, rotation_deg: float) -> dict:
    position = {"before": 0.0262, "before_sd": 0.01, "after": position_share * 0.1048, "after_sd": 0.01}
    rotation = {"before": 22.0, "before_sd": 20.0, "after": rotation_deg, "after_sd": 18.0}
    cone = {"name": "friction_cone", "parameters": {"cone": {"value": "elliptic"}}}
    size = {"name": "object_com", "parameters": {"offset_m": {"value": [0.001, 0.0, -0.002]}}}
    return {
        "verdict": "partly_explained",
        "effects": [cone, size],
        "measures": {"object_position_m": position, "object_rotation_deg": rotation},
        "data": {"episodes": {"held_out": 486}},
    }


def test_the_mean_of_the_splits_is_held_against_the_targets(compare):
    lines = compare.table({"split-0": report(0.12, 19.0), "split-1": report(0.13, 18.6)})
    text = "\n".join(lines)
    assert "split-0     partly_explained: friction_cone elliptic; object_com 0.001, 0, -0.002" in text
    assert "MuJoCo, nominal                             25.0 +-  9.5      22.0 +- 20.0" in text
    assert "MuJoCo, with the named effects              12.5 +-  9.5      18.8 +- 18.0" in text
    assert "486 held-out tosses a split" in text
    assert lines[-1] == "position reached, rotation missed"


def test_one_report_has_no_rows_of_splits(compare):
    lines = compare.table({"cube_report": report(0.14, 17.0)})
    assert sum("cube_report" in line for line in lines) == 1
    assert lines[-1] == "position missed, rotation reached"
