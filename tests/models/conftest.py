"""A tiny world for models: random windows, and a normaliser of made-up values."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from candata.loaders import Normaliser
from candata.models import Sizes, model
from candata.testing.models import SIZES, made_up_batch, made_up_normaliser, tiny_config
from candata.testing.models import generator as fresh_generator


@pytest.fixture
def batch() -> Callable[..., dict[str, torch.Tensor]]:
    """Makes batches of random windows: `batch(count, seed=...)`."""
    return made_up_batch


@pytest.fixture
def tiny() -> Callable[..., torch.nn.Module]:
    """Builds a tiny model: `tiny(name, **fields)`."""

    def make(name: str, sizes: Sizes = SIZES, **fields: object) -> torch.nn.Module:
        found = model(name)
        return found.build(tiny_config(found, **fields), sizes, made_up_normaliser(sizes))

    return make


@pytest.fixture
def generator() -> Callable[[int], torch.Generator]:
    """Makes torch generators: `generator(seed)`."""
    return fresh_generator


@pytest.fixture
def normaliser() -> Callable[..., Normaliser]:
    """Makes the made-up normaliser."""
    return made_up_normaliser


@pytest.fixture
def awake() -> Callable[[torch.nn.Module], torch.nn.Module]:
    """Moves every weight off its start, so that outputs that start at zero show something."""

    def move(module: torch.nn.Module, size: float = 0.05) -> torch.nn.Module:
        with torch.no_grad():
            for number, parameter in enumerate(module.parameters()):
                parameter += size * torch.randn(parameter.shape, generator=fresh_generator(number))
        return module

    return move
