"""The command `validate`: what is wrong in a dataset, what is doubtful, and what could not be checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.checks import Finding, Group
    from candata.datasets import Dataset

#: Level to the levels that make the command fail.
FAILS = {
    "error": ("error",),
    "warning": ("error", "warning"),
    "info": ("error", "warning", "info"),
    "unknown": ("error", "warning", "unknown"),
}
#: Episodes that a line names.
NAMED_EPISODES = 3

EXAMPLE = "Example: candata validate recordings --scene scene.yaml --html out/validation.html --fail-on warning"

DatasetName = Annotated[str, typer.Argument(metavar="DATASET", help="Folder or registered name.")]
Version = Annotated[str | None, typer.Option(help="Version: its number, the start of its digest, or a tag.")]
Rules = Annotated[
    list[str] | None, typer.Option("--rule", metavar="NAME", help="Apply this rule only; may be given again.")
]
SceneName = Annotated[
    str | None,
    typer.Option(
        "--scene",
        metavar="SCENE",
        help="Name or scene.yaml of the world: for limits, depth, distance, units and orders.",
    ),
]
Deep = Annotated[bool, typer.Option("--deep", help="Hash every file in full, and read dense channels.")]
FailOn = Annotated[
    str,
    typer.Option("--fail-on", metavar="LEVEL", help="Least level that makes exit 1: error, warning, info, unknown."),
]
Html = Annotated[Path | None, typer.Option("--html", metavar="FILE", help="Write a page as well.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, every finding in it.")]


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("validate", epilog=EXAMPLE)(validate)


@console.stoppable("nothing was checked to its end")
def validate(
    dataset: DatasetName,
    version: Version = None,
    rule: Rules = None,
    scene: SceneName = None,
    deep: Deep = False,
    fail_on: FailOn = "error",
    html: Html = None,
    json: Json = False,
) -> None:
    """Check a dataset: files, values, time, contact, forces, poses, commands; exit 1 when something is wrong.

    Findings are errors, warnings, infos, and unknown: what could not be checked, and why.
    """
    from candata.checks import check
    from candata.errors import UnknownNameError

    if fail_on not in FAILS:
        raise UnknownNameError("level for --fail-on", fail_on, FAILS)
    if html is not None:
        check_output(html, "file", "--html")
    data = console.open_named(dataset, version, partial=True)
    world = None
    if scene is not None:
        from candata.scenes import load_scene

        world = load_scene(scene)
    with console.progress("checking episodes", len(data)) as advance:
        findings = check(data, lambda: advance(1), rules=rule or None, deep=deep, scene=world)
    if html is not None:
        from candata.reports.validation import write_validation

        console.note(f"page: {write_validation(data, findings, html, scene=scene, deep=deep, rules=rule or None)}")
    if json:
        console.out_json(_record(data, findings, scene, deep))
    else:
        _print(len(data), findings)
    if any(finding.level in FAILS[fail_on] for finding in findings):
        raise typer.Exit(1)


def _record(data: Dataset, findings: Sequence[Finding], scene: str | None, deep: bool) -> dict[str, object]:
    """Return everything as plain data."""
    from dataclasses import asdict

    from candata.checks import LEVELS

    counts = Counter(finding.level for finding in findings)
    return {
        "dataset": data.name,
        "digest": data.digest,
        "version": data.version,
        "episodes": len(data),
        "scene": scene,
        "deep": deep,
        "counts": {level: counts[level] for level in LEVELS},
        "findings": [asdict(finding) | {"evidence": dict(finding.evidence)} for finding in findings],
    }


def _print(episodes: int, findings: Sequence[Finding]) -> None:
    """Print one line a group of findings, then what could not be checked."""
    from candata.checks import group_findings

    groups = group_findings(findings)
    shown_groups = [group for group in groups if group.level != "unknown"]
    if not shown_groups:
        console.out(f"{episodes} episode{'s' * (episodes != 1)}, no findings")
    else:
        rows = [_row(group, episodes) for group in shown_groups]
        console.out_table(("level", "rule", "channel", "episodes", "what"), rows)
        for remedy in dict.fromkeys((g.rule, g.findings[0].remedy) for g in shown_groups if g.findings[0].remedy):
            console.out(f"to do: {remedy[0]}: {remedy[1]}")
    reasons: dict[str, list[str]] = {}
    for group in groups:
        if group.level == "unknown":
            reasons.setdefault(group.findings[0].message, []).append(group.rule)
    for reason, rules in reasons.items():
        console.out(f"{reason}: {', '.join(rules)}")


def _row(group: Group, episodes: int) -> tuple[str, ...]:
    """Return the cells of a group: what was found, how many episodes, and the first of them."""
    names = group.episodes
    more_text = f" and {len(names) - NAMED_EPISODES} more" if len(names) > NAMED_EPISODES else ""
    names_text = f" [{', '.join(names[:NAMED_EPISODES])}{more_text}]" if names else ""
    count = f"{len(names)} of {episodes}" if names else "the set"
    return group.level, group.rule, group.channel or "-", count, group.text + names_text
