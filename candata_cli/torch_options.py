"""Options and checks of the commands that need torch."""

from __future__ import annotations

from typing import Annotated

import typer

Device = Annotated[str, typer.Option("--device", help="cpu or cuda.")]
Threads = Annotated[int | None, typer.Option("--threads", min=1, help="Threads of the CPU; torch's choice by default.")]


def need_torch() -> None:
    """Refuse to begin without the packages that training needs.

    Raises
    ------
    MissingExtraError
        Names the package and how to install it.
    """
    from importlib.util import find_spec

    from candata.errors import MissingExtraError

    for package in ("torch", "safetensors"):
        if find_spec(package) is None:
            raise MissingExtraError(package, "train")


def set_threads(threads: int | None) -> None:
    """Tell torch how many threads to use; None leaves it to torch."""
    import torch

    if threads is not None:
        torch.set_num_threads(threads)
