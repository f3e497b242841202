"""Experiments: a file of data, models and regimes becomes a graph of cells, each kept, and a table of their scores.

The names below are imported from their files on first use: a plan needs no torch, a training cell does.
"""

from __future__ import annotations

import importlib
from typing import Any

#: Name to the file of this room that defines it.
_HOMES = {
    "ExperimentFile": "config",
    "ExperimentTable": "results",
    "forecast_cells": "forecast",
    "plan_cells": "plan",
    "read_experiment": "config",
    "run_experiment": "run",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    """Return the object `name`, importing its file now.

    Raises
    ------
    AttributeError
        When the room has no such name.
    """
    if name not in _HOMES:
        raise AttributeError(f"module 'candata.experiment' has no attribute {name!r}")
    return getattr(importlib.import_module(f"candata.experiment.{_HOMES[name]}"), name)
