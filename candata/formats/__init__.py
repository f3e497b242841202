"""Foreign formats, one file each: a file here exports `FORMAT` and is registered under its own name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from candata.schema.episode import Episode


@dataclass(frozen=True)
class Format:
    """What a format's file offers.

    Attributes
    ----------
    name : str
        Registered name, equal to the file's.
    summary : str
        One line for people.
    read : callable
        `(source, allow_gaps) -> iterator of Episode`; opens nothing but the source.
    digest : callable
        `(source) -> str`, sha256 over what determines the episodes: equal for the same source.
    """

    name: str
    summary: str
    read: Callable[[Path, bool], Iterator[Episode]]
    digest: Callable[[Path], str]
