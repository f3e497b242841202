"""Foreign formats, one file each: a file here exports `FORMAT` and is registered under its own name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from numpy.typing import NDArray

from candata.plugins import Registry
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage


def _ignore_line(line: str) -> None:
    """Say nothing."""


def _ignore_cloud(points: NDArray) -> None:
    """Keep no cloud."""


@dataclass(frozen=True)
class Reading:
    """The settings of an import beside its source.

    Attributes
    ----------
    allow_gaps : bool
        Mark values that are not finite as invalid instead of refusing them.
    mapping : Path, optional
        File that says what becomes which channel, where the format takes one.
    source : str
        Whether the episodes are `sim` or `real`, where the file does not say.
    scene, object, task : str, optional
        What the file does not say of its episodes.
    note : callable
        Takes a line for people: what was left out, what was assumed.
    cloud : callable
        Takes a point cloud `(N, 3) float32 [m]` that an episode names by its content, to be kept with it.
    """

    allow_gaps: bool = False
    mapping: Path | None = None
    source: Literal["sim", "real"] = "real"
    scene: str | None = None
    object: str | None = None
    task: str | None = None
    note: Callable[[str], None] = field(default=_ignore_line, compare=False)
    cloud: Callable[[NDArray], None] = field(default=_ignore_cloud, compare=False)


@dataclass(frozen=True)
class Writing:
    """The settings of an export beside the episodes.

    Attributes
    ----------
    name, digest : str
        The version that is exported; both go into the file, so that it can be traced.
    lineage : tuple of Lineage
        How its episodes came to be.
    variant : str, optional
        Older layout of the format, where it has one.
    note : callable
        Takes a line for people: what the format cannot hold.
    cloud : callable, optional
        The points `(N, 3) float32 [m]` of the cloud that an episode names, where they are at hand.
    """

    name: str
    digest: str
    lineage: tuple[Lineage, ...] = ()
    variant: str | None = None
    note: Callable[[str], None] = field(default=_ignore_line, compare=False)
    cloud: Callable[[str], NDArray] | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Format:
    """A format: its name, and how it is read and written.

    Attributes
    ----------
    name : str
        Registered name, equal to the file's.
    summary : str
        One line for people.
    read : callable, optional
        `(source, reading) -> iterator of Episode`; opens nothing but the source and the mapping.
    takes_map : bool
        Whether `read` looks at `reading.mapping`.
    write : callable, optional
        `(episodes, folder, writing)`: writes the layout into an empty folder that stands; `episodes` may be
        iterated several times.
    variants : tuple of str
        Values of `writing.variant` that `write` knows.
    """

    name: str
    summary: str
    read: Callable[[Path, Reading], Iterator[Episode]] | None = None
    takes_map: bool = False
    write: Callable[[Iterable[Episode], Path, Writing], None] | None = None
    variants: tuple[str, ...] = ()


FORMATS = Registry("formats", "candata.formats", "FORMAT", Format, "summary")
