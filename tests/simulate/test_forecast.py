"""What a set would take, against what it takes."""

from __future__ import annotations

import pytest

from candata.datasets import open_dataset
from candata.errors import UsageError
from candata.simulate.forecast import forecast
from candata.simulate.generate import generate


def test_a_forecast_is_what_the_set_takes(tmp_path):
    options = {"policies": ("push", "free_sweep"), "duration_s": 0.4}
    told = forecast("gripper_tabletop", 20, 1, workers=1, **options)
    generate(tmp_path / "set", "gripper_tabletop", 20, 1, workers=1, **options)
    data = open_dataset(tmp_path / "set")
    rows = sum(data.catalog(("rows",)).column("rows").to_pylist())
    assert (told.episodes, told.rows, told.workers) == (20, rows, 1)
    assert told.steps == 4 * rows
    assert (told.tasks, told.objects) == ({"push": 10, "free_sweep": 10}, {"carton": 20})
    size = sum(path.stat().st_size for path in (tmp_path / "set").glob("parts/*/*.parquet"))
    # A part of few episodes spends more on its tables, a few kilobytes.
    assert size / 1e9 < told.gigabytes < 10 * size / 1e9
    assert told.minutes > 0


def test_a_shard_is_forecast_alone():
    assert forecast("cube_toss", 40, 1, duration_s=0.2, workers=1, shard=(2, 2)).episodes == 16


def test_what_cannot_be_made_is_refused_before_the_trial():
    with pytest.raises(UsageError, match="policy push cannot act in scene cube_toss"):
        forecast("cube_toss", 4, 1, policies=("push",))
