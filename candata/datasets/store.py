"""What push and pull need of the place behind a remote; each kind of place is a module that holds one class."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

#: Most bytes of a file that are read, or sent, at a time.
CHUNK_BYTES = 2**20


class Store(Protocol):
    """What push and pull need of a place; keys are made of checked names alone."""

    @property
    def url(self) -> str:
        """Where it is, for messages; holds no credential."""

    def folders(self) -> list[str]:
        """Return the names of the folders at its root, sorted."""

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the files in the folder `prefix` by name, with their size in bytes."""

    def read(self, key: str) -> Iterator[bytes]:
        """Yield the bytes of a file; raises FileNotFoundError where there is none."""

    def write(self, key: str, chunks: Iterable[bytes], size: int) -> None:
        """Keep a file, whole or not at all; one that stands is replaced. What `chunks` raises is passed on."""

    def create(self, key: str, data: bytes) -> bool:
        """Keep a file unless one stands; return whether this call made it."""

    def tidy(self, name: str) -> None:
        """Remove what killed pushes of the dataset `name` left and nobody can still be writing."""
