"""A tiny world for models: random windows, and a normaliser of made-up values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from candata.loaders import Normaliser, Scale
from candata.models import Sizes

SIZES = Sizes(history=4, horizon=8, joints=3, actuators=2, fingertips=2, points=20)

#: Fields that make any of the models tiny.
TINY = {
    "latent": 32, "temporal_width": 16, "point_widths": [8, 16], "widths": [16, 32], "time_features": 16,
}  # fmt: skip


def scale(centre: float, size: float, *shape: int) -> Scale:
    count = int(np.prod(shape))
    return Scale(shape=shape, centre=(centre,) * count, scale=(size,) * count)


def make_normaliser(sizes: Sizes = SIZES, increments: Scale | None = None) -> Normaliser:
    """Made-up scales: positions 0.2 m about 0.1, joints and actions 0.5 about 0.5, steps of 1 cm about 1 mm."""
    return Normaliser(
        method="robust", dataset="made-up", digest="", episodes=1, rows=1, windows=1, rate_hz=10, horizon=sizes.horizon,
        channels={
            "object_pose": scale(0.1, 0.2, 7),
            "joint_position": scale(0.5, 0.5, sizes.joints),
            "action": scale(0.5, 0.5, sizes.actuators),
        },
        increments=increments or scale(0.001, 0.01, sizes.horizon, 6),
    )  # fmt: skip


def make_batch(count: int = 5, seed: int = 0, sizes: Sizes = SIZES, clouds: int = 2) -> dict[str, torch.Tensor]:
    """Random windows without pads: steps of about 1 cm and 10 mrad, as tensors in SI units."""
    from candata.models import integrate

    g = torch.Generator().manual_seed(seed)
    rows, horizon = sizes.history, sizes.horizon
    start = torch.cat([0.2 * torch.randn(count, 3, generator=g), unit(torch.randn(count, 4, generator=g))], dim=-1)
    poses = integrate(start, 0.01 * torch.randn(count, rows + horizon, 6, generator=g))
    return {
        "history/object_pose": poses[:, :rows],
        "future/object_pose": poses[:, rows:],
        "history/joint_position": torch.randn(count, rows, sizes.joints, generator=g),
        "history/action": torch.randn(count, rows, sizes.actuators, generator=g),
        "planned/action": torch.randn(count, horizon, sizes.actuators, generator=g),
        "history/contact": torch.rand(count, rows, generator=g) < 0.5,
        "future/contact": torch.rand(count, horizon, generator=g) < 0.5,
        "history/fingertip_contact": torch.rand(count, rows, sizes.fingertips, generator=g) < 0.5,
        "history_pad": torch.zeros(count, rows, dtype=torch.bool),
        "future_pad": torch.zeros(count, horizon, dtype=torch.bool),
        "cloud": torch.arange(count) % clouds,
        "clouds": 0.05 * torch.randn(clouds, sizes.points, 3, generator=g),
    }


def unit(q: torch.Tensor) -> torch.Tensor:
    return q / q.norm(dim=-1, keepdim=True)


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture
def batch() -> Callable[..., dict[str, torch.Tensor]]:
    """Makes batches of random windows: `batch(count, seed=...)`."""
    return make_batch


@pytest.fixture
def tiny() -> Callable[..., torch.nn.Module]:
    """Builds a tiny model: `tiny(name, **fields)`."""
    from candata.models import model

    def make(name: str, sizes: Sizes = SIZES, **fields: object) -> torch.nn.Module:
        found = model(name)
        common = {"width": 32, "layers": 2} if name == "mlp" else TINY
        return found.build(found.parse(common | fields), sizes, make_normaliser(sizes))

    return make


@pytest.fixture
def generator() -> Callable[[int], torch.Generator]:
    """Makes torch generators: `generator(seed)`."""
    return seeded


@pytest.fixture
def normaliser() -> Callable[..., Normaliser]:
    """Makes the made-up normaliser."""
    return make_normaliser


@pytest.fixture
def awake() -> Callable[[torch.nn.Module], torch.nn.Module]:
    """Moves every weight off its start, so that outputs that start at zero show something."""

    def move(module: torch.nn.Module, size: float = 0.05) -> torch.nn.Module:
        with torch.no_grad():
            for number, parameter in enumerate(module.parameters()):
                parameter += size * torch.randn(parameter.shape, generator=seeded(number))
        return module

    return move
