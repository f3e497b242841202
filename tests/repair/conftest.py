"""Scenes to export: a user's in one file, a user's in several, and a built-in one."""

from __future__ import annotations

import pytest

from candata.scenes import load_scene
from tests.effects.gripper import write_scene
from tests.repair.rig import write_rig


@pytest.fixture(scope="session")
def gripper(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("gripper"))


@pytest.fixture(scope="session")
def rig(tmp_path_factory):
    return write_rig(tmp_path_factory.mktemp("rig"))


@pytest.fixture(scope="session")
def hand():
    return load_scene("xhand_tabletop")
