"""The page of a validation: what is wrong, in which episodes and when, what to do, and what could not be checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path
from textwrap import shorten

from candata.checks import LEVELS, Finding, Group, Level, grouped, meanings
from candata.datasets import Dataset
from candata.datasets.writing import write_text
from candata.reports.document import document

#: Level to its colour in `style.COLOURS`, and what it is called in numbers of one and more.
TONES = {"error": "bad", "warning": "part", "info": "accent", "unknown": "none"}
PLURALS = {"error": "errors", "warning": "warnings", "info": "remarks", "unknown": "not checked"}
SAYS = {
    "error": "These episodes cannot be trusted.",
    "warning": "Worth a look before training on them.",
    "info": "True and worth knowing; nothing is wrong.",
    "unknown": "Could not be checked; the reason is given below.",
}
#: Episodes of a group that are listed, and time ranges of one.
LISTED, RANGES = 40, 4
#: Longest piece of evidence on the page [characters]; --json has all.
EVIDENCE = 100
DASH = "\N{EN DASH}"
STYLE = (
    "<style>.tag{display:inline-block;padding:0 8px;border-radius:9px;font-size:12px;font-weight:650;"
    "color:var(--paper);background:var(--of)}details.card{margin:0 0 10px;padding:4px 16px}"
    "summary{cursor:pointer;padding:8px 0}details table{min-width:640px}"
    "summary b{font-weight:650}summary small{color:var(--muted);font-size:13px}.do{margin:0 0 8px}"
    ".share{display:inline-block;width:72px;height:6px;border-radius:3px;background:var(--rule);"
    "vertical-align:middle;margin-right:8px}.share i{display:block;height:6px;border-radius:3px;"
    "background:var(--of)}@media print{details>*{display:block}}</style>"
)


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
    groups = grouped(findings)
    counts = Counter(group.level for group in groups)
    tone, headline = _headline(counts)
    kicker = f"{data.name}@{data.digest[:12]}, version {data.version}, {len(data)} episodes"
    kicker += f", scene {scene}" if scene else ""
    body = (
        f'{STYLE}<header><p class="kicker">{escape(kicker)}</p><h1>{escape(headline)}</h1>'
        f'<p class="meaning">{escape(_manner(deep, rules))}</p></header>{_answers(groups, len(data))}'
    )
    for level in LEVELS[:3]:
        body += _section(level, [g for g in groups if g.level == level], len(data))
    body += _unknown([g for g in groups if g.level == "unknown"]) + _rules(groups, rules)
    return document(f"{headline}: {data.name}", tone, body, "")


def _headline(counts: Counter[Level]) -> tuple[str, str]:
    """Return a colour and the headline."""
    if counts["error"]:
        return "bad", "Something is wrong"
    if counts["warning"]:
        return "part", "Something is doubtful"
    return "good", "Nothing wrong was found"


def _manner(deep: bool, rules: Sequence[str] | None) -> str:
    """Return how it was checked, in a sentence."""
    which = f"Rules: {', '.join(rules)}." if rules else "All rules."
    how = "every file hashed in full" if deep else "files compared by size and episodes by content, not hashed in full"
    return f"{which} Stored data as they lie on the disk, {how}."


def _answers(groups: Sequence[Group], episodes: int) -> str:
    """Return one number a level."""
    cells = ""
    for level in LEVELS:
        some = [g for g in groups if g.level == level]
        touched = {name for g in some for name in g.episodes}
        text = f"{SAYS[level]} {len(touched)} of {episodes} episodes." if touched else SAYS[level]
        cells += (
            f'<div><dt>{escape(PLURALS[level].capitalize())}</dt><dd><span class="lead big" '
            f'style="color:var(--{TONES[level] if some else "muted"})">{len(some)}</span>{escape(text)}</dd></div>'
        )
    return f'<dl class="answers">{cells}</dl>'


def _section(level: str, groups: Sequence[Group], episodes: int) -> str:
    """Return the findings of a level, each group to be opened."""
    if not groups:
        return ""
    inner = "".join(_group(group, episodes, number == 0) for number, group in enumerate(groups))
    return f"<h2>{escape(PLURALS[level].capitalize())}</h2>{inner}"


def _group(group: Group, episodes: int, opened: bool) -> str:
    """Return one group: its line, what to do, and its episodes."""
    names = group.episodes
    share = 100 * len(names) / max(episodes, 1) if names else 100
    count = f"{len(names)} of {episodes} episodes" if names else "the set"
    channel = f" in <code>{escape(group.channel)}</code>" if group.channel else ""
    remedy = group.findings[0].remedy
    head = (
        f'<summary><span class="tag">{escape(group.level)}</span> <b>{escape(group.problem)}</b>{channel} '
        f'<small>{escape(group.rule)}</small><br><span class="share"><i style="width:{share:.0f}%"></i></span>'
        f"<small>{escape(count)}</small></summary>"
    )
    todo = f'<p class="do"><b>To do:</b> {escape(remedy)}</p>' if remedy else ""
    rest = len(group.findings) - LISTED
    more = f'<p class="note">and {rest} more: candata validate --json lists all</p>' if rest > 0 else ""
    rows = "".join(_row(finding) for finding in group.findings[:LISTED])
    table = (
        '<div class="scroll" tabindex="0"><table class="wrap"><thead><tr><th>episode</th><th>what</th><th>when</th>'
        f"<th>evidence</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )
    shown = " open" if opened else ""
    return f'<details class="card" style="--of:var(--{TONES[group.level]})"{shown}>{head}{todo}{table}{more}</details>'


def _row(finding: Finding) -> str:
    """Return one finding: episode, words, times, numbers."""
    when = ", ".join(f"{a:.3g}{DASH}{b:.3g} s" if b > a else f"{a:.3g} s" for a, b in finding.ranges[:RANGES])
    when += f" and {len(finding.ranges) - RANGES} more" if len(finding.ranges) > RANGES else ""
    numbers = ", ".join(
        f"{name} {shorten(str(value), EVIDENCE, placeholder=' ...')}" for name, value in finding.evidence.items()
    )
    cells = (finding.episode or "the set", finding.message, when or "throughout", numbers or DASH)
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"


def _unknown(groups: Sequence[Group]) -> str:
    """Return what could not be checked, and why."""
    if not groups:
        return ""
    rows = "".join(
        f"<tr><td>{escape(g.rule)}</td><td>{escape(meanings().get(g.rule, ''))}</td>"
        f"<td>{escape(g.findings[0].message)}</td></tr>"
        for g in groups
    )
    return (
        '<h2>What could not be checked</h2><div class="scroll" tabindex="0"><table class="terms"><thead><tr>'
        f"<th>rule</th><th>it would say that</th><th>why not</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _rules(groups: Sequence[Group], rules: Sequence[str] | None) -> str:
    """Return every rule that was applied, and what it found."""
    rows = ""
    for name, meaning in meanings().items():
        if rules is not None and name not in rules:
            continue
        levels = [g.level for g in groups if g.rule == name]
        worst = min(levels, key=LEVELS.index, default=None)
        state = (
            "nothing found" if worst is None else PLURALS[worst] if worst != "unknown" else "not, or partly, checked"
        )
        rows += f"<tr><td>{escape(name)}</td><td>{escape(meaning)}</td><td>{escape(state)}</td></tr>"
    return (
        '<h2>Rules</h2><div class="scroll" tabindex="0"><table class="terms"><thead><tr><th>rule</th>'
        f"<th>it says that</th><th>result</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )
