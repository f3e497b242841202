"""Every object that can be named keeps what all objects must."""

from candata.scenes.contract import OBJECTS
from candata.testing import ObjectConformance
from tests.suites import suites

globals().update(suites(ObjectConformance, OBJECTS, "object"))
