"""What a reader is to the mutations: what it reads, and how it is read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple


class Reader(NamedTuple):
    """One reader and what it reads.

    Attributes
    ----------
    write : callable
        `(folder, rows)`: writes sound files into an empty folder.
    read : callable
        `(folder) -> contents`; raises an error of candata where it refuses.
    files : str
        Pattern of the files that are mutated.
    whole : bool
        Whether hashes guard the contents: they are as they were written, or refused.
    """

    write: Callable[[Path, int], object]
    read: Callable[[Path], Any]
    files: str = "**/*"
    whole: bool = False
