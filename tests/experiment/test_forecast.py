"""What an experiment will take: trials that leave nothing, and no work counted twice."""

from __future__ import annotations

import pytest

from candata.datasets import append, create_dataset
from candata.experiment.config import read_experiment
from candata.experiment.forecast import forecast_cells
from candata.experiment.plan import plan_cells
from candata.schema.manifest import Lineage
from tests.experiment.conftest import TINY, standing_set
from tests.training.conftest import gliding

TINY_CONFIG = {"cloud": "none", "latent": 16, "temporal_width": 8, "widths": [8, 16], "groups": 8}
CORRECTION = TINY | {"model": "sim_residual", "config": TINY_CONFIG}


@pytest.fixture
def forecast_of(experiment_file, tmp_path, monkeypatch):
    """The forecast of an experiment's cells by name; nothing may be left in the folder or in the cache."""

    def of(**changes: object):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
        rows = forecast_cells(plan_cells(read_experiment(experiment_file(**changes))), tmp_path / "out", 1)
        assert not (tmp_path / "out").exists()
        assert not (tmp_path / "cache").exists()
        return {row.name: row for row in rows}

    return of


def test_forecasts_of_a_simulator_count_for_the_first_run_on_a_set_alone(forecast_of):
    data = {
        "sim": {"generate": {"scene": "cube_toss", "episodes": 40, "duration_s": 0.6}},
        "real": {"sealed": {"scene": "cube_toss", "outside": "wind", "duration_s": 0.6, "train": 2, "test": 3}},
    }
    windows = {"history": 3, "horizon": 4, "rate_hz": 37}
    changes = {"data": data, "models": {"corrected": CORRECTION}, "seeds": [0, 1], "windows": windows}
    rows = forecast_of(**changes, regimes=["sim"], rows=["simulator"])
    first, second = (rows[f"train/single/corrected/nominal/sim/seed-{seed}"].hours for seed in (0, 1))
    assert 0 < second < first
    assert rows["evaluation/single/rows"].hours > 0
    assert rows["data/real"].hours < rows["data/sim"].hours


def test_cells_of_one_digest_count_once_and_each_evaluation_by_its_test_episodes(forecast_of, tmp_path):
    standing_set(tmp_path, "large", 20)
    data = {name: {"path": name} for name in ("sim", "real", "large")}
    columns = {name: {"sim": "sim", "real": real} for name, real in (("a", "real"), ("b", "large"))}
    rows = forecast_of(data=data, columns=columns, regimes=["sim"])
    first, second = (rows[f"train/{name}/mlp/nominal/sim/seed-0"].hours for name in columns)
    assert 0 == second < first
    # By the default split one of ten episodes is for testing.
    first, second = (rows[f"evaluation/{name}/mlp/nominal/sim/train-0/seed-0"].hours for name in columns)
    assert 0 < second == pytest.approx(2 * first)


def test_a_model_is_tried_with_the_points_that_its_set_will_have(forecast_of, tmp_path):
    root = create_dataset(tmp_path / "bare", name="bare")
    append(root, (gliding(f"bare-{k}", k) for k in range(10)), Lineage(operation="test"))
    changes = {
        "data": {"bare": {"path": "bare", "cloud_of": "cube_toss"}},
        "columns": {"single": {"real": "bare"}},
        "models": {"unet": TINY | {"config": TINY_CONFIG | {"cloud": "object"}}},
    }
    assert forecast_of(**changes, regimes=["real"])["train/single/unet/nominal/real/train-all/seed-0"].hours > 0
