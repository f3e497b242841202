"""What a rule is and what it finds."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from candata.checks._evidence import LEVELS, Finding, Level

if TYPE_CHECKING:
    from candata.checks._view import View
    from candata.datasets import RawPart
    from candata.scenes import Scene

#: A number that is no part of a name.
_NUMBER = re.compile(r"(?<![\w.])([-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?![\w]|\.\d)")
#: Kinds of findings that differ in more than numbers, of which a line tells.
_TOLD = 3


@dataclass(frozen=True)
class Group:
    """Findings that are the same in words: one line for people.

    Attributes
    ----------
    level, rule, channel, problem
        What they share.
    findings : tuple of Finding
        At least one.
    """

    level: Level
    rule: str
    channel: str | None
    problem: str
    findings: tuple[Finding, ...]

    @property
    def episodes(self) -> tuple[str, ...]:
        """Episodes that show it, each once; empty where it is true of the set."""
        return tuple(dict.fromkeys(f.episode for f in self.findings if f.episode is not None))

    @property
    def text(self) -> str:
        """What was found, in one line: numbers that differ between the findings as `least..largest`.

        Findings that differ in more than numbers, such as in a joint's name, follow each other, the most frequent
        first. What concerns the set is said in full.
        """
        alike: dict[tuple[str, ...], list[list[str]]] = {}
        for one in self.findings:
            pieces = _NUMBER.split(one.message)
            alike.setdefault(tuple(pieces[::2]), []).append(pieces[1::2])
        told = [_merged(words, numbers) for words, numbers in sorted(alike.items(), key=lambda kind: -len(kind[1]))]
        listed = told[:_TOLD] if self.episodes else told
        more = f"; {len(told) - len(listed)} more" if len(told) > len(listed) else ""
        return "; ".join([listed[0], *(text.removeprefix(f"{self.problem}: ") for text in listed[1:])]) + more


def _merged(words: Sequence[str], numbers: Sequence[Sequence[str]]) -> str:
    """Return words with numbers between them, each as `least..largest` where it differs."""
    columns = [sorted(set(column), key=float) for column in zip(*numbers, strict=True)]
    ranges = [column[0] if len(column) == 1 else f"{column[0]}..{column[-1]}" for column in columns]
    return "".join(text for pair in zip(words, [*ranges, ""], strict=True) for text in pair)


def grouped(findings: Sequence[Finding]) -> tuple[Group, ...]:
    """Return findings by what they share, the gravest first, then those of most episodes."""
    groups: dict[tuple[Level, str, str | None, str], list[Finding]] = {}
    for one in findings:
        groups.setdefault((one.level, one.rule, one.channel, one.problem or one.message), []).append(one)
    made = [Group(*key, tuple(some)) for key, some in groups.items()]
    return tuple(sorted(made, key=lambda g: (LEVELS.index(g.level), -len(g.findings), g.rule)))


def _part_fine(part: RawPart, deep: bool) -> Iterator[Finding]:
    """Find nothing in a part."""
    return iter(())


def _episode_fine(view: View) -> Iterator[Finding]:
    """Find nothing in an episode."""
    return iter(())


@dataclass(frozen=True)
class Rule:
    """One way of looking at stored data; a file in this folder exports one as `RULE`.

    A rule looks at parts, at episodes one by one, or at the set: then `gather` keeps a few numbers an episode and
    `judge` sees them all once at the end. Rows are never kept, so memory grows with the episodes by these numbers only.

    Attributes
    ----------
    meaning : str
        One line for people.
    part : callable
        `(part, deep)` yields what is wrong with a part's files.
    episode : callable
        Yields what is wrong with an episode as stored, which may be anything.
    gather : callable, optional
        Returns what `judge` is to know of an episode; None where it tells nothing.
    judge : callable, optional
        Yields what is wrong with the set, from what was gathered (at least one).
    sample : callable, optional
        `(views, scene)` yields what is wrong with some whole episodes, drawn at random from the set, in the scene.
    needs : tuple of str
        Channels without which an episode is not looked at: it counts as not checked.
    scene : bool
        Whether it needs a scene: without one it is not checked.
    idle : str
        Why nothing could be checked where `gather` returned None for every episode; empty where nothing was to be.
    """

    meaning: str
    part: Callable[[RawPart, bool], Iterator[Finding]] = _part_fine
    episode: Callable[[View], Iterator[Finding]] = _episode_fine
    gather: Callable[[View], Any] | None = None
    judge: Callable[[Sequence[Any]], Iterator[Finding]] | None = None
    sample: Callable[[Sequence[View], Scene], Iterator[Finding]] | None = None
    needs: tuple[str, ...] = ()
    scene: bool = False
    idle: str = ""
