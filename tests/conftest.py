"""Shared by all tests: fixed seeds, and the shared recordings where a checkout has them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

# Two workers on two cores: a thread pool in each would only get in the other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator with a fixed seed."""
    return np.random.default_rng(20240501)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of shared recordings beside the checkout (or CANDATA_SHARED); skips without it."""
    folder = Path(os.environ.get("CANDATA_SHARED", ROOT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip("no shared recordings beside this checkout")
    return folder
