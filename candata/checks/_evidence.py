"""One finding: its grade, its place and the numbers that show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Level = Literal["error", "warning", "info", "unknown"]
#: Grades, the gravest first.
LEVELS: tuple[Level, ...] = ("error", "warning", "info", "unknown")

Evidence = float | int | str


@dataclass(frozen=True)
class Finding:
    """Something wrong, doubtful or worth knowing in a dataset, or something that could not be checked.

    Attributes
    ----------
    level : str
        `error` (the data cannot be trusted), `warning` (worth a look), `info` (true and worth knowing) or `unknown`
        (could not be checked; `problem` says why).
    rule : str
        File name of the rule.
    message : str
        What was expected and what was found, with numbers.
    episode, channel : str or None
        Where; None where it is true of the set, or of the whole episode.
    index : int or None
        First row of the episode that shows it.
    problem : str
        The same in words without numbers: findings of one rule that share it are one line for people.
    ranges : tuple of (float, float)
        Times from the episode's first row that show it [s]; empty where it is the whole episode.
    evidence : mapping of str to number or str
        What was measured, a unit in each name.
    remedy : str
        What to do.
    """

    level: Level
    rule: str
    message: str
    episode: str | None = None
    channel: str | None = None
    index: int | None = None
    problem: str = ""
    ranges: tuple[tuple[float, float], ...] = ()
    evidence: Mapping[str, Evidence] = field(default_factory=dict)
    remedy: str = ""
