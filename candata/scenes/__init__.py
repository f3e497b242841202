"""Scenes: a model plus the roles of its parts."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from candata.scenes.assemble import Scene, load_scene

__all__ = ["Scene", "load_scene"]


def __getattr__(name: str) -> Any:
    """Return a public name, imported on first use: the process of a first load needs little of this room.

    Raises
    ------
    AttributeError
        When the name is not public.
    """
    if name not in __all__:
        raise AttributeError(f"module 'candata.scenes' has no attribute {name!r}")
    return getattr(importlib.import_module("candata.scenes.assemble"), name)
