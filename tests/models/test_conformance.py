"""Every model keeps what all models must."""

from candata.models import MODELS
from candata.testing import ModelConformance
from tests.suites import suites

globals().update(suites(ModelConformance, MODELS, "model"))
