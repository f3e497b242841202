"""Every policy keeps what all policies must."""

from candata.policies import POLICIES
from candata.testing import PolicyConformance
from tests.suites import suites

globals().update(suites(PolicyConformance, POLICIES, "policy"))
