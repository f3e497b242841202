"""Public data sets, one file each: a file here exports `SOURCE`; users write its name with dashes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from candata.plugins import Registry
from candata.schema.episode import Episode


@dataclass(frozen=True)
class FetchedEpisodes:
    """Checked data at hand.

    Attributes
    ----------
    episodes : iterator of Episode
        The episodes, each checked when it is taken.
    digest : str
        sha256 over what determines the episodes; equal however they were had.
    notice : str
        The licence text that has to stay with every copy.
    """

    episodes: Iterator[Episode]
    digest: str
    notice: str


@dataclass(frozen=True)
class FetchedObject:
    """An object at hand: its name, the folder of its meshes (`visual.obj`, `convex_0.stl`, ...), its mass [kg]."""

    name: str
    folder: Path
    mass_kg: float


@dataclass(frozen=True)
class FetchedObjects:
    """Checked objects at hand.

    Attributes
    ----------
    objects : iterator of FetchedObject
        The objects, each checked when it is taken.
    count : int
        How many they are.
    notice : str
        The licence text that has to stay with every copy.
    """

    objects: Iterator[FetchedObject]
    count: int
    notice: str


@dataclass(frozen=True)
class PublicDataset:
    """A public set of episodes, or of objects.

    Attributes
    ----------
    name : str
        Registered name, equal to the file's.
    summary : str
        One line for people.
    origin : str
        Where it is published, with the revision.
    licence : str
        SPDX name of its licence.
    from_folder : callable
        `(folder) -> FetchedEpisodes` or `FetchedObjects`, from a prepared folder, hashes checked.
    download : callable
        `(cache folder, say)` to the same, from its public place; `say` takes lines about the progress.
    """

    name: str
    summary: str
    origin: str
    licence: str
    from_folder: Callable[[Path], FetchedEpisodes | FetchedObjects]
    download: Callable[[Path, Callable[[str], None]], FetchedEpisodes | FetchedObjects]


SOURCES = Registry("sources", "candata.fetch", "SOURCE", PublicDataset, "summary")
