"""Models: one file each; the folder is the registry. Needs the extra `train`."""

from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.plugins import load, names

PACKAGE = "candata.models"

__all__ = ["Batch", "Forecast", "Losses", "Model", "Sizes", "model", "model_names"]


def model_names() -> tuple[str, ...]:
    """Return the names of all models: the files of the folder."""
    return names(PACKAGE)


def model(name: str) -> Model:
    """Return the model called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    """
    found: Model = load(PACKAGE, "MODEL", name)
    return found
