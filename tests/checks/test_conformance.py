"""Every check keeps what all checks must; what it must find is a defect that names it."""

import pytest

from candata.checks import RULES
from candata.checks.defects import DEFECTS
from candata.testing import CheckConformance
from tests.suites import suites


def damage_for(rule: str):
    """What the suite of a rule injects: the defect that it alone must find, where there is one."""
    defect = next((known for known in DEFECTS.values() if known.rules == (rule,)), None)

    def damage(self, arrays, rate_hz, rng):
        if defect is None:
            pytest.skip(f"no defect is for {rule} alone: test_defects.py and its own tests make what it must find")
        if not set(defect.channels) <= set(arrays):
            return None
        return defect.damage(arrays, rate_hz, defect.severity, rng)

    return damage


#: A drift of clocks shows in episodes that are long beside the lags [s], and where several joints move freely: a hand.
LONGER = {"stream_drift": {"duration_s": 3.2, "scenes": ("xhand_tabletop",)}}

globals().update(
    suites(
        CheckConformance,
        RULES,
        "rule",
        **{name: {"damage": damage_for(name)} | LONGER.get(name, {}) for name in RULES.names()},
    )
)
