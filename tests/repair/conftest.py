"""Scenes to export: two of a user in one file each, a user's in several, and a built-in one."""

from __future__ import annotations

import pytest

from candata.scenes import load_scene
from tests.effects.gripper import write_scene
from tests.effects.pan_tilt import write_neck
from tests.repair.rig import write_rig


@pytest.fixture(scope="session")
def gripper(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("gripper"))


@pytest.fixture(scope="session")
def neck(tmp_path_factory):
    return write_neck(tmp_path_factory.mktemp("neck"))


@pytest.fixture(scope="session")
def rig(tmp_path_factory):
    return write_rig(tmp_path_factory.mktemp("rig"))


@pytest.fixture(scope="session")
def hand():
    return load_scene("xhand_tabletop")
