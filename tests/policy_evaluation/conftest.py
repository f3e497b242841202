"""A gripper's recordings, and what is read of them once for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from candata.datasets import open_dataset
from candata.policy_evaluation.starts import real_starts
from candata.scenes import load_scene
from candata.simulate.generate import generate

DURATION_S = 1.6


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """Ten grasps of a gripper."""
    folder = tmp_path_factory.mktemp("recorded") / "data"
    generate(folder, "gripper_tabletop", 10, 1, workers=1, duration_s=DURATION_S, policies=("grasp_lift_shake",))
    return open_dataset(folder)


@pytest.fixture(scope="session")
def gripper():
    return load_scene("gripper_tabletop")


@pytest.fixture(scope="session")
def starts(gripper, recorded):
    """Three starts."""
    return real_starts(gripper, recorded, recorded.ids, 3)[0]


@pytest.fixture
def policies(tmp_path):
    """Writes a file of policies: `policies({"name": ..., "source": ...}, ...)`."""

    def write(*entries: dict) -> Path:
        path = tmp_path / "policies.yaml"
        path.write_text(yaml.safe_dump(list(entries)))
        return path

    return write
