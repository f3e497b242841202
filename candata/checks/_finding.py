"""What a rule is and what it finds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from candata.datasets import RawEpisode, RawPart

Level = Literal["error", "warning"]


@dataclass(frozen=True)
class Finding:
    """Something wrong, or doubtful, in a dataset.

    Attributes
    ----------
    level : str
        `error` (the data cannot be trusted) or `warning` (worth a look).
    rule : str
        File name of the rule.
    message : str
        What was expected and what was found.
    episode, channel : str or None
    index : int or None
        Where: row of the episode.
    """

    level: Level
    rule: str
    message: str
    episode: str | None = None
    channel: str | None = None
    index: int | None = None


def _part_fine(part: RawPart) -> Iterator[Finding]:
    """Find nothing in a part."""
    return iter(())


def _episode_fine(episode: RawEpisode) -> Iterator[Finding]:
    """Find nothing in an episode."""
    return iter(())


@dataclass(frozen=True)
class Rule:
    """One way of looking at stored data; a file in this folder exports one as `RULE`.

    Attributes
    ----------
    meaning : str
        One line for people.
    part : callable
        Yields what is wrong with a part's files.
    episode : callable
        Yields what is wrong with an episode as stored, which may be anything.
    """

    meaning: str
    part: Callable[[RawPart], Iterator[Finding]] = _part_fine
    episode: Callable[[RawEpisode], Iterator[Finding]] = _episode_fine
