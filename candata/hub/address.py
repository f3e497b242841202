"""Addresses of data sets on the Hub: `hf:ORG/NAME[@REVISION]`."""

from __future__ import annotations

import re
from dataclasses import dataclass

from candata.errors import UsageError

PREFIX = "hf:"
#: Names as the Hub allows them. Source: huggingface_hub, `utils/_validators.py`, `validate_repo_id`.
_ADDRESS = re.compile(r"hf:([A-Za-z0-9][\w.-]*)/([A-Za-z0-9][\w.-]*)(?:@([\w][\w./-]*))?")


@dataclass(frozen=True)
class HubAddress:
    """A data set on the Hub: owner, name, and a branch, tag or commit; the newest commit of `main` without one."""

    owner: str
    name: str
    revision: str | None = None

    @property
    def repository(self) -> str:
        """Owner and name, as the Hub calls it."""
        return f"{self.owner}/{self.name}"

    def __str__(self) -> str:
        """Return the address as it is written."""
        return f"{PREFIX}{self.repository}" + (f"@{self.revision}" if self.revision else "")


def is_hub_address(text: str) -> bool:
    """Tell whether a text is meant as an address on the Hub."""
    return text.startswith(PREFIX)


def parse_address(text: str) -> HubAddress:
    """Return the address that a text holds.

    Raises
    ------
    UsageError
        When it is none.
    """
    match = _ADDRESS.fullmatch(text)
    if match is None or ".." in text:
        raise UsageError("this is no address on the Hub", expected="hf:ORG/NAME or hf:ORG/NAME@REVISION", found=text)
    return HubAddress(*match.groups())
