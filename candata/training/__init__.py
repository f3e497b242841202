"""Training: one loop, checkpoints without pickle, metrics, evaluation beside plain baselines.

The names below are imported from their files on first use: metrics need no torch, training does.
"""

from __future__ import annotations

import importlib
from typing import Any

#: Name to the file of this room that defines it.
_HOMES = {
    "TrainRequest": "jobs",
    "Evaluation": "results",
    "TrainingJob": "loop",
    "EvaluationSettings": "evaluation",
    "Progress": "settings",
    "TrainingReport": "loop",
    "Run": "settings",
    "TrainingSettings": "settings",
    "Track": "results",
    "evaluate": "evaluation",
    "prepare": "jobs",
    "train": "loop",
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
        raise AttributeError(f"module 'candata.training' has no attribute {name!r}")
    return getattr(importlib.import_module(f"candata.training.{_HOMES[name]}"), name)
