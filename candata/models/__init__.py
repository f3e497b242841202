"""Models: one file each; the folder is the registry. Needs the extra `train`."""

from typing import Any

from candata.errors import MissingExtraError
from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.plugins import EXTRAS, Registry

MODELS = Registry("models", "candata.models", "MODEL", Model, "summary")
#: Functions on poses; they need torch, so they are imported on first use.
_POSES = ("increments", "integrate", "targets")

__all__ = ["MODELS", "Batch", "Forecast", "Losses", "Model", "Sizes", "model", "model_names", *_POSES]


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
    """Return a function on poses, imported on first use."""
    if name not in _POSES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        from candata.models import _poses
    except ModuleNotFoundError as error:
        if error.name not in EXTRAS:
            raise
        raise MissingExtraError(error.name, EXTRAS[error.name]) from None
    return getattr(_poses, name)
