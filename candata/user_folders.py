"""Folders of the user's in which candata keeps what it can make again."""

from __future__ import annotations

import os
from pathlib import Path


def user_cache() -> Path:
    """Return the user's cache folder (XDG base directory specification).

    Raises
    ------
    RuntimeError
        When the user has no home folder.
    """
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "candata"
