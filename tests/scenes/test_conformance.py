"""Every scene that can be named keeps what all scenes must."""

from candata.scenes.contract import SCENES
from candata.testing import SceneConformance
from tests.suites import suites

globals().update(suites(SceneConformance, SCENES, "scene"))
