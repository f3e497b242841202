"""What suites share: claims with a message, refusals, and the way from a plug-in to its name."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from candata.errors import CandataError
from candata.plugins import Registry


def require(holds: object, otherwise: str) -> None:
    """Return nothing where a claim holds.

    Raises
    ------
    AssertionError
        Where it does not; `otherwise` says what is wrong.
    """
    if not holds:
        raise AssertionError(otherwise)


def registered_name(registry: Registry[Any], plugin: object) -> str:
    """Return the name under which a plug-in is registered_name.

    Raises
    ------
    AssertionError
        Where it is not.
    """
    name = registry.name_of(plugin)
    if name is None:
        raise AssertionError(
            f'the {registry.contract.__name__} is not registered: add NAME = "module:{registry.constant}" to the entry '
            f'points "candata.{registry.kind}" of your pyproject.toml, and install the package (pip install -e .)'
        )
    return name


def require_words(registry: Registry[Any], plugin: object) -> None:
    """Claim that a plug-in has a line for people, and its module a docstring."""
    name = registered_name(registry, plugin)
    line = getattr(plugin, registry.summary)
    require(line and "\n" not in line, f"{name}: `{registry.summary}` is not one line")
    module = registry.module(name)
    require(importlib.import_module(module).__doc__, f"{module} has no docstring")


def refusal_of(run: Callable[[], object], action: str) -> CandataError:
    """Return the error of candata with which something is refused.

    Raises
    ------
    AssertionError
        Where it is not refused; another exception passes through.
    """
    try:
        run()
    except CandataError as error:
        return error
    raise AssertionError(f"{action} is not refused")
