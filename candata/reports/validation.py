"""The page of a validation: what is wrong, in which episodes and when, what to do, and what could not be checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten

from candata.checks import LEVELS, Finding, Group, Level, group_findings, meanings
from candata.datasets import Dataset
from candata.datasets.writing import write_text
from candata.reports.document import render_page
from candata.reports.numbers import digits
from candata.reports.words import sentence_case

#: Level to its colour in `templates/style.css.j2`.
TONES = {"error": "bad", "warning": "part", "info": "accent", "unknown": "none"}
#: Level to the heading above its findings.
PLURALS = {"error": "errors", "warning": "warnings", "info": "remarks", "unknown": "not checked"}
#: Level to what it means for the reader.
CONSEQUENCES = {
    "error": "Do not use these episodes before this is mended.",
    "warning": "Worth a look before you train on these episodes.",
    "info": "Worth knowing; nothing is wrong.",
    "unknown": "Rules that could not be applied in full, for the reasons given below. This is no error.",
}
#: Level to what it means that there is nothing of it.
NOTHING = {
    "error": "Each rule that was applied is kept.",
    "warning": "Nothing is doubtful.",
    "info": "There is nothing to add.",
    "unknown": "Every rule was applied in full.",
}
#: How the reason of a rule that was not applied begins; the page's heading says it already.
NOT_CHECKED = "not checked"
#: Episodes of a group that are listed, and time ranges of an episode.
MOST_EPISODES, MOST_RANGES = 40, 4
#: Longest piece of evidence on the page [characters]; --json has all.
EVIDENCE_LENGTH = 100
DASH = "\N{EN DASH}"


@dataclass(frozen=True)
class FindingGroup:
    """The findings of one rule that say the same: a line, what to do, and the episodes."""

    level: str
    tone: str
    problem: str
    channel: str | None
    rule: str
    percent: float
    count: str
    remedy: str
    rows: tuple[tuple[str, ...], ...]
    unlisted_count: int


def write_validation(
    data: Dataset,
    findings: Sequence[Finding],
    path: Path,
    *,
    scene: str | None = None,
    deep: bool = False,
    rules: Sequence[str] | None = None,
) -> Path:
    """Return the path of the page after writing it, whole or not at all.

    Parameters
    ----------
    data : Dataset
        What was checked.
    findings : sequence of Finding
        What `check` found.
    path : Path
        File to write; its folder is made.
    scene, deep, rules
        How it was checked.

    Raises
    ------
    SetupError
        When the file cannot be written.
    """
    return write_text(path, page(data, findings, scene=scene, deep=deep, rules=rules))


def page(
    data: Dataset,
    findings: Sequence[Finding],
    *,
    scene: str | None = None,
    deep: bool = False,
    rules: Sequence[str] | None = None,
) -> str:
    """Return the whole page as text; it asks for nothing from elsewhere."""
    groups = group_findings(findings)
    tone, headline = _headline(Counter(group.level for group in groups))
    kicker = f"{data.name}@{data.digest[:12]}, version {data.version}, {len(data)} episodes"
    by_level = {level: [_group(g, len(data)) for g in groups if g.level == level] for level in LEVELS[:3]}
    return render_page(
        "validation",
        title=f"{headline}: {data.name}",
        tone=tone,
        headline=headline,
        kicker=f"{kicker}, scene {scene}" if scene else kicker,
        meaning=_method(deep, rules),
        answers=[_answer(level, [g for g in groups if g.level == level], len(data)) for level in LEVELS],
        sections=[(PLURALS[level].capitalize(), level_groups) for level, level_groups in by_level.items()],
        unchecked=[
            (g.rule, meanings().get(g.rule, ""), _reason(g.findings[0].message)) for g in groups if g.level == "unknown"
        ],
        rules=_rules(groups, rules),
    )


def _headline(counts: Counter[Level]) -> tuple[str, str]:
    """Return a colour and the headline."""
    if counts["error"]:
        return "bad", "Errors found"
    if counts["warning"]:
        return "part", "Warnings, no errors"
    return "good", "No errors found"


def _method(deep: bool, rules: Sequence[str] | None) -> str:
    """Return how it was checked, in two sentences."""
    rule_words = f"These rules were tried: {', '.join(rules)}." if rules else "All rules were tried."
    depth = (
        "Every file was hashed in full."
        if deep
        else "Files were compared by size, episodes by content; --deep hashes all."
    )
    return f"{rule_words} {depth}"


def _reason(message: str) -> str:
    """Return why a rule was not applied, as a sentence without its full stop."""
    return sentence_case(message.removeprefix(NOT_CHECKED).lstrip(": "))


def _answer(level: Level, groups: Sequence[Group], episode_count: int) -> tuple[str, str, int, str]:
    """Return name, colour, number of groups and sentence of a level."""
    heading = PLURALS[level].capitalize()
    if not groups:
        return heading, "muted", 0, NOTHING[level]
    episodes = {name for group in groups for name in group.episodes}
    count = f" {len(episodes)} of {episode_count} episodes." if episodes else ""
    return heading, TONES[level], len(groups), CONSEQUENCES[level] + count


def _group(group: Group, episode_count: int) -> FindingGroup:
    """Return what the page shows of a group."""
    count = len(group.episodes)
    return FindingGroup(
        level=group.level,
        tone=TONES[group.level],
        problem=sentence_case(group.problem),
        channel=group.channel,
        rule=group.rule,
        percent=100 * count / max(episode_count, 1) if count else 100,
        count=f"{count} of {episode_count} episodes" if count else "the set",
        remedy=group.findings[0].remedy or "",
        rows=tuple(_row(finding) for finding in group.findings[:MOST_EPISODES]),
        unlisted_count=max(len(group.findings) - MOST_EPISODES, 0),
    )


def _row(finding: Finding) -> tuple[str, ...]:
    """Return one finding: episode, words, times, numbers."""
    times = ", ".join(f"{a:.3g}{DASH}{b:.3g} s" if b > a else f"{a:.3g} s" for a, b in finding.ranges[:MOST_RANGES])
    if len(finding.ranges) > MOST_RANGES:
        times += f" and {len(finding.ranges) - MOST_RANGES} more"
    numbers = ", ".join(f"{name} {_evidence(value)}" for name, value in finding.evidence.items())
    return finding.episode or "the set", finding.message, times or "throughout", numbers or DASH


def _evidence(value: object) -> str:
    """Return a piece of evidence in a few characters; --json has all of it."""
    text = digits(value) if isinstance(value, float) else str(value)
    return shorten(text, EVIDENCE_LENGTH, placeholder=" ...")


def _rules(groups: Sequence[Group], rules: Sequence[str] | None) -> list[tuple[str, str, str]]:
    """Return every rule that was applied, what it says, and its result."""
    rows = []
    for name, meaning in meanings().items():
        if rules is not None and name not in rules:
            continue
        levels = [group.level for group in groups if group.rule == name]
        worst_level = min(levels, key=LEVELS.index, default=None)
        result = "kept" if worst_level is None else PLURALS[worst_level]
        rows.append((name, meaning, "not checked in full" if worst_level == "unknown" else result))
    return rows
