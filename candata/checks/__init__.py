"""Validation rules: the folder is the registry, one file a rule, each exports `RULE`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from candata import plugins
from candata.checks._finding import Finding, Rule
from candata.errors import DataError

if TYPE_CHECKING:
    from candata.datasets import Dataset, RawPart

__all__ = ["Finding", "Rule", "check"]


def check(dataset: Dataset, progress: Callable[[], None] = lambda: None) -> tuple[Finding, ...]:
    """Return everything the rules find in a version, part by part; nothing when it is sound.

    Looks at what is stored, without making episodes of it, so that it reports what could not be made one.

    Parameters
    ----------
    dataset : Dataset
        Opened with `partial=True` where damage is to be listed.
    progress : callable
        Called after each part.
    """
    rules = [plugins.load(__name__, "RULE", name) for name in plugins.names(__name__)]
    found: list[Finding] = []
    for part in dataset.raw_parts():
        found += _check_part(part, rules)
        progress()
    return tuple(found)


def _check_part(part: RawPart, rules: list[Rule]) -> Iterator[Finding]:
    """Yield what the rules find in one part; an unreadable part is left to the rule on files."""
    for rule in rules:
        yield from rule.part(part)
    try:
        for episode in part.episodes():
            for rule in rules:
                yield from rule.episode(episode)
    except DataError as error:
        yield Finding("error", "hashes", f"{part.relative(error.where.path)}: {error.found}")
