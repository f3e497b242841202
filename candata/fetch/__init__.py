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
class PublicDataset:
    """A public data set.

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
        `(folder) -> Fetched`, from a prepared folder, hashes checked.
    download : callable
        `(cache folder, say) -> Fetched`, from its public place; `say` takes lines about the progress.
    """

    name: str
    summary: str
    origin: str
    licence: str
    from_folder: Callable[[Path], FetchedEpisodes]
    download: Callable[[Path, Callable[[str], None]], FetchedEpisodes]


SOURCES = Registry("sources", "candata.fetch", "SOURCE", PublicDataset, "summary")
