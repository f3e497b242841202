"""The source of an import where it is an address on the Hub."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from candata_cli import console

if TYPE_CHECKING:
    from candata.hub import HubSet


def hub_source(format_name: str, source: str) -> HubSet | None:
    """Return the set that an address names, downloaded; None where the source is no address.

    Raises
    ------
    UsageError
        When the address is wrong, there is no such set, or the format is not that of sets on the Hub.
    SetupError
        When the Hub cannot be reached or refuses.
    """
    if not source.startswith("hf:"):
        return None
    from candata.errors import UsageError
    from candata.hub import download_set, parse_address
    from candata.user_folders import user_cache

    if format_name != "lerobot":
        raise UsageError(
            f"`import {format_name}` reads no address on the Hub",
            expected="candata import lerobot hf:ORG/NAME",
            found=source,
        )
    cache = user_cache()
    with console.stoppable(f"files that were fetched whole are kept in {cache}", goes_on=True):
        return download_set(parse_address(source), cache, console.note)


def source_details(source: Path, hub_set: HubSet | None) -> dict[str, str]:
    """Return what the lineage says of a source: its name, or its address on the Hub and its licence."""
    if hub_set is None:
        return {"source": source.resolve().name}
    return {"source": str(source)} | ({"licence": hub_set.licence} if hub_set.licence else {})
