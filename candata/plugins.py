"""A folder is its registry: file name = registered name, one exported constant."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from typing import Any

from candata.errors import UnknownNameError


@cache
def names(package: str) -> tuple[str, ...]:
    """Return the registered names of a folder, sorted, without importing its files.

    Names that begin with `_`, and those that the folder lists as `NOT_PLUGINS`, are none.

    Parameters
    ----------
    package : str
        Dotted name of the folder, such as `candata.effects`.
    """
    folder = importlib.import_module(package)
    found = (m.name for m in pkgutil.iter_modules(folder.__path__))
    others = getattr(folder, "NOT_PLUGINS", ())
    return tuple(sorted(n for n in found if not n.startswith("_") and n not in others))


@cache
def load(package: str, constant: str, name: str) -> Any:
    """Return the constant that the file `name` of the folder exports.

    Raises
    ------
    UnknownNameError
        When the folder has no such file; lists the ones it has.
    """
    if name not in names(package):
        raise UnknownNameError(constant.lower(), name, names(package))
    return getattr(importlib.import_module(f"{package}.{name}"), constant)
