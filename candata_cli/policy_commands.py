"""The command `policy evaluate`: policies from held-out real starts in several worlds, one page for all."""

from __future__ import annotations

import typer

from candata_cli import console


def register(app: typer.Typer) -> None:
    """Add `policy evaluate`; other files add to the group `policy`."""
    console.group(app, "policy", console.POLICY)
