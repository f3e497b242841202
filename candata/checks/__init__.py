"""Validation rules: the folder is the registry, one file a rule, each exports `RULE`."""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from candata.checks._finding import LEVELS, Finding, Group, Level, Rule, group_findings
from candata.checks._view import EpisodeView
from candata.errors import DataError
from candata.plugins import Registry

if TYPE_CHECKING:
    from candata.datasets import Dataset, RawPart
    from candata.scenes import Scene

__all__ = [
    "LEVELS",
    "RULES",
    "EpisodeView",
    "Finding",
    "Group",
    "Level",
    "Rule",
    "check",
    "group_findings",
    "meanings",
    "rule_names",
]

#: The file of this folder that is no rule: it makes the defects that rules must find.
NOT_PLUGINS = ("defects",)
RULES = Registry("checks", "candata.checks", "RULE", Rule, "meaning")
#: Episodes that are kept whole for rules that play the scene. Chosen: an exchange in a tenth of them shows in two of 48
#: with a chance of 0.96, and 48 episodes of a hand take some 10 MB.
SAMPLE_SIZE = 48


def rule_names() -> tuple[str, ...]:
    """Return the names of all rules that can be applied, sorted."""
    return tuple(RULES.load_all())


def meanings() -> dict[str, str]:
    """Return what each rule says, by name."""
    return {name: rule.meaning for name, rule in RULES.load_all().items()}


def check(
    dataset: Dataset,
    progress: Callable[[], None] = lambda: None,
    *,
    rules: Sequence[str] | None = None,
    deep: bool = False,
    scene: Scene | None = None,
) -> tuple[Finding, ...]:
    """Return everything the rules find in a version, the gravest first; nothing wrong where it is sound.

    Looks at what is stored, once and episode by episode, without making episodes of it, so that it reports what could
    not be made one. What could not be checked is a finding of the level `unknown`, one a reason, with the number of
    episodes.

    Parameters
    ----------
    dataset : Dataset
        Opened with `partial=True` where damage is to be listed.
    progress : callable
        Called after each episode.
    rules : sequence of str, optional
        Names of the rules to apply; all when omitted.
    deep : bool
        Hash every file, and read dense channels; otherwise files are compared by their size.
    scene : Scene, optional
        The world the episodes were recorded in: some rules need it.

    Raises
    ------
    UnknownNameError
        When there is no such rule.
    PluginError
        When a rule that is asked for comes from another package and cannot be used.
    """
    rules_by_name = RULES.load_all() if rules is None else {name: RULES.load(name) for name in rules}
    gathered_values: dict[str, list[Any]] = defaultdict(list)
    gathering_rules: set[str] = set()
    findings: list[Finding] = []
    sample = (
        _EpisodeSample(np.random.default_rng(0))
        if scene is not None and any(r.sample for r in rules_by_name.values())
        else None
    )
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        # Statistics of rows without a value are NaN, which no comparison takes for a finding.
        warnings.simplefilter("ignore", RuntimeWarning)
        for part, views in _views(dataset, deep, scene):
            for rule in rules_by_name.values():
                findings += rule.part(part, deep)
            try:
                for view in views:
                    findings += _look(view, rules_by_name, gathered_values, gathering_rules)
                    if sample is not None:
                        sample.add(view)
                    progress()
            except DataError as error:
                if "hashes" in rules_by_name:
                    findings.append(_unreadable(part, error))
        for rule in rules_by_name.values():
            if rule.sample is not None and sample is not None and scene is not None and sample.views:
                findings += rule.sample(sample.views, scene)
        for name, rule in rules_by_name.items():
            if rule.judge is not None and gathered_values[name]:
                findings += rule.judge(gathered_values[name])
            elif rule.judge is not None and rule.idle_reason and name in gathering_rules:
                findings.append(Finding("unknown", name, rule.idle_reason, problem=rule.idle_reason))
    return tuple(sorted(_unknown_once(findings), key=lambda f: LEVELS.index(f.level)))


class _EpisodeSample:
    """Episodes drawn at random from those that pass by, each as likely as any other (Vitter 1985, algorithm R)."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.views: list[EpisodeView] = []
        self._rng, self._seen = rng, 0

    def add(self, view: EpisodeView) -> None:
        """Keep the episode or not; it takes the place of another once there are `SAMPLE_SIZE`."""
        self._seen += 1
        if len(self.views) < SAMPLE_SIZE:
            self.views.append(view)
        elif (place := int(self._rng.integers(self._seen))) < SAMPLE_SIZE:
            self.views[place] = view


def _views(dataset: Dataset, deep: bool, scene: Scene | None) -> Iterator[tuple[RawPart, Iterator[EpisodeView]]]:
    """Yield each part with its episodes as far as they belong to the version, each id once."""
    left_out = set(dataset.file.exclusions)
    for part in dataset.raw_parts():
        yield part, _part_views(part, left_out, deep, scene)


def _part_views(part: RawPart, left_out: set[str], deep: bool, scene: Scene | None) -> Iterator[EpisodeView]:
    """Yield the episodes of a part that are not left out, and leave them out from there on."""
    rows = part.rows()
    for number in sorted({row["row_group"] for row in rows}):
        for raw in part.group(number, rows):
            if raw.id not in left_out:
                left_out.add(raw.id)
                yield EpisodeView(part.with_dense(raw) if deep else raw, scene, deep)


def _look(
    view: EpisodeView, rules: Mapping[str, Rule], gathered_values: dict[str, list[Any]], gathering_rules: set[str]
) -> Iterator[Finding]:
    """Yield what the rules find in one episode, and keep what they gather."""
    for name, rule in rules.items():
        reason = _obstacle(view, rule)
        if reason:
            yield Finding("unknown", name, reason, view.id, problem=reason)
            continue
        yield from rule.episode(view)
        if rule.gather is not None:
            gathering_rules.add(name)
            value = rule.gather(view)
            if value is not None:
                gathered_values[name].append(value)


def _obstacle(view: EpisodeView, rule: Rule) -> str:
    """Return why a rule cannot look at an episode; nothing where it can."""
    if rule.scene and view.scene is None:
        return "no scene was given (--scene)"
    missing_channels = [name for name in rule.needs if name not in view.raw.arrays]
    if missing_channels:
        return f"no {' and no '.join(missing_channels)}"
    if rule.needs and view.time_s is None:
        return "time does not increase"
    unusable = [name for name in rule.needs if name != "time_ns" and view.complete_values(name) is None]
    return f"no valid rows of {' and '.join(unusable)}" if unusable else ""


def _unreadable(part: RawPart, error: DataError) -> Finding:
    """Return the finding that a part cannot be read; the rule on files speaks of what it can tell itself."""
    return Finding(
        "error",
        "hashes",
        f"{part.relative(error.where.path)}: {error.found}",
        problem="a file cannot be read",
        remedy="restore the file from a copy",
    )


def _unknown_once(findings: Sequence[Finding]) -> Iterator[Finding]:
    """Yield findings, with one for all episodes that a rule could not look at for the same reason."""
    counts: dict[tuple[str, str], int] = defaultdict(int)
    for finding in findings:
        if finding.level == "unknown":
            counts[finding.rule, finding.problem] += finding.episode is not None
        else:
            yield finding
    for (rule, reason), episodes in counts.items():
        extent = f" in {episodes} episode{'s' * (episodes != 1)}" if episodes else ""
        yield replace(
            Finding("unknown", rule, f"not checked{extent}: {reason}", problem=reason),
            evidence={"episodes": episodes} if episodes else {},
        )
