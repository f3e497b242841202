"""Models: one file each; the folder is the registry. Needs the extra `train`."""

from typing import Any

from candata.errors import MissingExtraError
from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.plugins import load, names

PACKAGE = "candata.models"
#: Functions on poses; they need torch, so they are imported on first use.
_POSES = ("increments", "integrate", "targets")

__all__ = ["Batch", "Forecast", "Losses", "Model", "Sizes", "model", "model_names", *_POSES]


def model_names() -> tuple[str, ...]:
    """Return the names of all models: the files of the folder."""
    return names(PACKAGE)


def model(name: str) -> Model:
    """Return the model called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    MissingExtraError
        When torch is not installed.
    """
    try:
        registered_model: Model = load(PACKAGE, "MODEL", name)
    except ModuleNotFoundError as error:
        raise _missing_extra(error) from None
    return registered_model


def __getattr__(name: str) -> Any:
    """Return a function on poses, imported on first use."""
    if name not in _POSES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        from candata.models import _poses
    except ModuleNotFoundError as error:
        raise _missing_extra(error) from None
    return getattr(_poses, name)


def _missing_extra(error: ModuleNotFoundError) -> Exception:
    """Return what to raise: the install hint when it is torch that is missing."""
    return MissingExtraError("torch", "train") if error.name == "torch" else error
