"""Policies that answer step by step, in a closed loop: a function of a user's module, or a network in a file."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from candata.errors import DataError, UsageError, Where
from candata.policies._contract import Plan, Step
from candata.policies._network import SUFFIX, read_network
from candata.policies._postures import finish, postures, times
from candata.scenes import Scene


@dataclass(frozen=True)
class StepPolicy:
    """A policy that gives one command after the other.

    Attributes
    ----------
    name : str
        What it is called: the function's name, or the file's.
    digest : str
        SHA-256 of the module's source, or of the network and its card.
    begin : callable
        `(scene, rng) -> step`, called once an episode; `step(observation)` returns the commands `(A,)`.
    """

    name: str
    digest: str
    begin: Callable[[Scene, np.random.Generator], Step]


def read_step_policy(source: str) -> StepPolicy:
    """Return the policy that `package.module:function`, `FILE.py:function` or `FILE.safetensors` names.

    Raises
    ------
    UsageError
        When there is no such module, function or file.
    DataError
        When the module fails while it is imported, or the network or its card is not valid.
    """
    if source.endswith(SUFFIX):
        path = Path(source)
        network, digest = read_network(path)
        return StepPolicy(path.stem, digest, lambda scene, _rng: network.begin(scene))
    module_name, colon, name = source.rpartition(":")
    if not colon or not module_name or not name:
        raise UsageError(
            f"{source!r} names no policy",
            expected="package.module:function, FILE.py:function, or a network FILE.safetensors",
        )
    module = _module(module_name)
    function = getattr(module, name, None)
    if not callable(function):
        raise UsageError(
            f"{module_name} has no function {name}",
            found=", ".join(sorted(_functions(module))) or "no function",
            where=Where(path=str(getattr(module, "__file__", module_name))),
        )
    return StepPolicy(name, _source_digest(module), lambda scene, rng: _begun(source, function, scene, rng))


def _begun(source: str, function: Callable[..., Any], scene: Scene, rng: np.random.Generator) -> Step:
    """Return what a user's function gives for one episode, once it is known to be a function."""
    try:
        step = function(scene, rng)
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and type(error) is not SystemExit:
            raise  # a worker is told to leave
        raise DataError(
            "the policy fails before its first step",
            expected=f"a function step(observation) from {source}(scene, rng)",
            found=f"{type(error).__name__}: {error}",
        ) from error
    if not callable(step):
        raise DataError(
            "the policy does not begin",
            expected=f"a function step(observation) from {source}(scene, rng)",
            found=type(step).__name__,
        )
    return step


def opening_plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan from which a closed loop begins: the hand is open, the object stands at random."""
    commands = np.repeat(postures(scene).open[None], len(times(scene, duration_s)), axis=0)
    return finish(scene, commands, rng, dither=False)


def _functions(module: Any) -> list[str]:
    """Return the names of the functions that a module defines itself."""
    return [n for n, f in inspect.getmembers(module, inspect.isfunction) if f.__module__ == module.__name__]


def _module(name: str) -> Any:
    """Return a module by its dotted name, as seen from the working folder, or by its file."""
    path = Path(name)
    try:
        if name.endswith(".py"):
            if not path.is_file():
                raise UsageError(f"{name} does not exist", expected="a Python file", where=Where(path=name))
            spec = importlib.util.spec_from_file_location(path.stem, path)
            if spec is None or spec.loader is None:
                raise UsageError(f"{name} is no Python file", where=Where(path=name))
            _see_modules_in(path.resolve().parent)
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            return module
        _see_modules_in(Path.cwd())
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not (name == error.name or name.startswith(f"{error.name}.")):
            raise _failed_import(name, error) from None
        raise UsageError(
            f"there is no module {name}",
            expected="a module that can be imported from this folder, or a .py file",
            fix="give FILE.py:function",
        ) from None
    except UsageError:
        raise
    except Exception as error:
        raise _failed_import(name, error) from error


def _see_modules_in(folder: Path) -> None:
    """Let modules in a folder be imported, behind all others."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _failed_import(name: str, error: Exception) -> DataError:
    """Return the error for a module that fails while it is imported."""
    return DataError(
        "the policy's module fails while it is imported",
        found=f"{type(error).__name__}: {error}",
        where=Where(path=name),
    )


def _source_digest(module: Any) -> str:
    """Return the SHA-256 of a module's source file; of its name where it has none."""
    path = getattr(module, "__file__", None)
    content = Path(path).read_bytes() if path is not None and Path(path).is_file() else module.__name__.encode()
    return hashlib.sha256(content).hexdigest()
