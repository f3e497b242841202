"""Conformance suites: what every plug-in must keep, whoever wrote it.

The tests of a package take one in two lines:

    from candata.testing import EffectConformance

    class TestStiction(EffectConformance):
        effect = EFFECT

The plug-in must be registered (a file of candata's folder, or an entry point of an installed package), since users come
to it by its name. A suite is a plain class whose methods pytest collects; nothing here imports pytest.
"""

from __future__ import annotations

import importlib
from typing import Any

#: Suite to its module; imported on first use, since each needs another room (and models need torch).
_HOMES = {
    "CheckConformance": "candata.testing.checks",
    "DeviceConformance": "candata.testing.devices",
    "EffectConformance": "candata.testing.effects",
    "FormatConformance": "candata.testing.formats",
    "ModelConformance": "candata.testing.models",
    "ObjectConformance": "candata.testing.objects",
    "PolicyConformance": "candata.testing.policies",
    "SceneConformance": "candata.testing.scenes",
    "StreamConformance": "candata.testing.streams",
}

__all__ = [
    "CheckConformance",
    "DeviceConformance",
    "EffectConformance",
    "FormatConformance",
    "ModelConformance",
    "ObjectConformance",
    "PolicyConformance",
    "SceneConformance",
    "StreamConformance",
]


def __getattr__(name: str) -> Any:
    """Return a suite, importing its module now.

    Raises
    ------
    AttributeError
        When there is no such suite.
    """
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
