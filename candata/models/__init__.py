"""Models: one file each; the folder is the registry. Needs the extra `train`."""

import importlib
from typing import Any

from candata.errors import MissingExtraError
from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.plugins import EXTRAS, Registry

MODELS = Registry("models", "candata.models", "MODEL", Model, "summary")
#: What a model's file is written with, to its module; most need torch, so they are imported on first use.
_HOMES = {
    "HistoryConfig": "candata.models._config",
    "Share": "candata.models._sharing",
    "Reader": "candata.models._inputs",
    "WindowGenerators": "candata.models._diffusion",
    "integers": "candata.models._diffusion",
    "normal": "candata.models._diffusion",
    "uniform": "candata.models._diffusion",
    "increments": "candata.models._poses",
    "integrate": "candata.models._poses",
    "known_steps": "candata.models._inputs",
    "masked_mean": "candata.models._inputs",
    "parser": "candata.models._config",
    "sharing": "candata.models._sharing",
    "with_seed": "candata.models._seed",
    "targets": "candata.models._poses",
}

__all__ = ["MODELS", "Batch", "Forecast", "Losses", "Model", "Sizes", "model", "model_names", *_HOMES]


def model_names() -> tuple[str, ...]:
    """Return the names of all models: the files of the folder, and those of other packages."""
    return MODELS.names()


def model(name: str) -> Model:
    """Return the model called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    MissingExtraError
        When torch is not installed.
    PluginError
        When it comes from another package and cannot be used.
    """
    return MODELS.load(name)


def __getattr__(name: str) -> Any:
    """Return what models are written with, imported on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(importlib.import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        if error.name not in EXTRAS:
            raise
        raise MissingExtraError(error.name, EXTRAS[error.name]) from None
