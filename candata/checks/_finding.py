"""Rules and their findings."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from candata.checks._evidence import LEVELS, Finding, Level

if TYPE_CHECKING:
    from candata.checks._view import EpisodeView
    from candata.datasets import RawPart
    from candata.scenes import Scene

#: A number that is no part of a name.
_NUMBER = re.compile(r"(?<![\w.])([-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?![\w]|\.\d)")
#: Kinds of findings that one line lists; kinds differ in more than numbers.
_KINDS_LISTED = 3


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
        """The findings in one line; numbers that differ between them are given as `least..largest`.

        Findings that differ in more than numbers, such as in a joint's name, follow each other, the most frequent
        first. What concerns the set is said in full.
        """
        numbers_by_words: dict[tuple[str, ...], list[list[str]]] = {}
        for finding in self.findings:
            pieces = _NUMBER.split(finding.message)
            numbers_by_words.setdefault(tuple(pieces[::2]), []).append(pieces[1::2])
        texts = [
            _merge_numbers(words, numbers)
            for words, numbers in sorted(numbers_by_words.items(), key=lambda kind: -len(kind[1]))
        ]
        listed_texts = texts[:_KINDS_LISTED] if self.episodes else texts
        omission = f"; {len(texts) - len(listed_texts)} more" if len(texts) > len(listed_texts) else ""
        return (
            "; ".join([listed_texts[0], *(text.removeprefix(f"{self.problem}: ") for text in listed_texts[1:])])
            + omission
        )


def _merge_numbers(words: Sequence[str], numbers: Sequence[Sequence[str]]) -> str:
    """Return words with numbers between them, each as `least..largest` where it differs."""
    columns = [sorted(set(column), key=float) for column in zip(*numbers, strict=True)]
    ranges = [column[0] if len(column) == 1 else f"{column[0]}..{column[-1]}" for column in columns]
    return "".join(text for pair in zip(words, [*ranges, ""], strict=True) for text in pair)


def group_findings(findings: Sequence[Finding]) -> tuple[Group, ...]:
    """Return findings by what they share, the gravest first, then those of most episodes."""
    findings_by_key: dict[tuple[Level, str, str | None, str], list[Finding]] = {}
    for finding in findings:
        findings_by_key.setdefault(
            (finding.level, finding.rule, finding.channel, finding.problem or finding.message), []
        ).append(finding)
    groups = [Group(*key, tuple(members)) for key, members in findings_by_key.items()]
    return tuple(sorted(groups, key=lambda g: (LEVELS.index(g.level), -len(g.findings), g.rule)))


def _no_part_findings(part: RawPart, deep: bool) -> Iterator[Finding]:
    """Return no findings: the rule does not look at parts."""
    return iter(())


def _no_episode_findings(view: EpisodeView) -> Iterator[Finding]:
    """Return no findings: the rule does not look at single episodes."""
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
    idle_reason : str
        Why nothing could be checked where `gather` returned None for every episode; empty where nothing was to be.
    """

    meaning: str
    part: Callable[[RawPart, bool], Iterator[Finding]] = _no_part_findings
    episode: Callable[[EpisodeView], Iterator[Finding]] = _no_episode_findings
    gather: Callable[[EpisodeView], Any] | None = None
    judge: Callable[[Sequence[Any]], Iterator[Finding]] | None = None
    sample: Callable[[Sequence[EpisodeView], Scene], Iterator[Finding]] | None = None
    needs: tuple[str, ...] = ()
    scene: bool = False
    idle_reason: str = ""
