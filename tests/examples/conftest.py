"""Scripts of the examples as modules."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture(scope="session")
def loaded() -> Callable[[str], ModuleType]:
    """The function that returns a script of the examples as a module, by its path there; it finds its neighbours."""

    def load(path: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(f"example_{Path(path).stem}", FOLDER / path)
        assert spec is not None
        assert spec.loader is not None
        made = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = made
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend((FOLDER / path).parent)
            spec.loader.exec_module(made)
        return made

    return load
