"""Scenes that the tests of effects share."""

from __future__ import annotations

import pytest

from candata.scenes import load_scene
from tests.effects.gripper import write_scene


@pytest.fixture(scope="module")
def hand():
    """The built-in hand."""
    return load_scene("xhand_tabletop")


@pytest.fixture(scope="module")
def gripper(tmp_path_factory):
    """Two fingers on a rail, a box on a table, explicit contact pairs."""
    return write_scene(tmp_path_factory.mktemp("gripper"))
