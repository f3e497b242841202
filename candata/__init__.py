"""Contact-rich manipulation data in one physical schema, and a diagnosis of the sim-to-real gap.

The names below are the public surface, each imported from its room on first use; `candata.plot` draws (extra `plot`).
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

if sys.platform == "win32":
    raise ImportError("candata runs on Linux and macOS; Windows is not supported")

__version__ = "0.1.0"

#: Public name to the module that defines it. No name is that of a module: it would hide the module.
_HOMES = {
    "Effect": "candata.effects",
    "Episode": "candata.schema.episode",
    "Scene": "candata.scenes",
    "diagnose": "candata.gap",
    "load_scene": "candata.scenes",
    "open_dataset": "candata.datasets",
    "rollout": "candata.simulate",
    "windows": "candata.loaders",
}

__all__ = ["Effect", "Episode", "Scene", "diagnose", "load_scene", "open_dataset", "rollout", "windows"]


def __getattr__(name: str) -> Any:
    """Return the public object `name` or the module `plot`, importing it now.

    Raises
    ------
    AttributeError
        When the name is not public.
    MissingExtraError
        When `plot` is asked for and matplotlib is not installed.
    """
    if name == "plot":
        return importlib.import_module("candata.plot")
    if name not in _HOMES:
        raise AttributeError(f"module 'candata' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__, "__version__"]
