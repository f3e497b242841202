"""The command that shows what is in a dataset: inspect."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.datasets import Dataset
    from candata.datasets.compare import DatasetComparison
    from candata.datasets.summary import Summary
    from candata.schema.episode import EpisodeMeta

_EXAMPLE = """\b
Examples:
  candata inspect recordings
  candata inspect recordings --html out/recordings.html
  candata inspect recordings --episode grasp-003 --html out/grasp.html
  candata inspect sim --against recordings --html out/both.html
"""
#: Rows of a comparison that the terminal shows; the page and --json have all.
SHOWN_ROWS = 15

Version = Annotated[str | None, typer.Option(help="Version: its number, the start of its digest, or a tag.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("inspect", epilog=_EXAMPLE)(inspect)


def inspect(
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="Folder or registered name.")],
    episode: Annotated[str | None, typer.Option("--episode", metavar="ID", help="Only this episode.")] = None,
    against: Annotated[
        str | None, typer.Option("--against", metavar="DATASET", help="Compare motion, force and contact with it.")
    ] = None,
    html: Annotated[Path | None, typer.Option("--html", metavar="FILE", help="Page to write as well.")] = None,
    scene: Annotated[
        str | None,
        typer.Option("--scene", metavar="SCENE", help="With --html: name or scene.yaml of the hand [the episode's]."),
    ] = None,
    version: Version = None,
    json: Json = False,
) -> None:
    """Print what is in a dataset: episodes, channels and ranges, contact, phases, lineage; draw it with --html.

    The page lists all episodes and plays them: hand and object in space, and traces on one time line.
    With --against, the same statistics of two datasets side by side, what differs most first.
    """
    from candata.errors import UsageError

    if html is not None:
        check_output(html, "file", "--html")
    if scene is not None and (html is None or against is not None):
        raise UsageError("--scene draws the hand in the page of one dataset", fix="give --html FILE, or leave it out")
    data = console.open_named(dataset, version)
    if against is None:
        _inspect_one(data, episode, html, scene, json)
    elif episode is not None:
        raise UsageError("--episode and --against do not go together", fix="leave one of them out")
    else:
        _inspect_two(data, console.open_named(against), html, json)


def _inspect_one(data: Dataset, episode: str | None, html: Path | None, scene: str | None, json: bool) -> None:
    """Print and draw one dataset, or one episode of it."""
    from candata.datasets.summary import summarise
    from candata.datasets.survey import survey

    ids = None if episode is None else [episode]
    recording = None if episode is None else data.episode(episode)
    with console.progress("reading episodes", len(data) if ids is None else 1) as advance:
        if html is None:
            summary = summarise(data, lambda: advance(1), ids)
        else:
            from candata.reports.playback import Playbacks

            playbacks = Playbacks(data, scene)
            dataset_survey = survey(data, lambda: advance(1), ids, playbacks.add)
            summary = dataset_survey.summary
    if html is not None:
        from candata.datasets.writing import write_text
        from candata.reports.inspection import page

        write_text(html, page(dataset_survey, playbacks, recording))
        console.note(f"{html}: {html.stat().st_size / 1e6:.2f} MB")
    meta = None if recording is None else recording.meta
    if json:
        record = summary.model_dump(mode="json")
        console.out_json(record if meta is None else {"episode": meta.model_dump(mode="json")} | record)
    else:
        _print_summary(summary, meta)


def _inspect_two(data: Dataset, reference: Dataset, html: Path | None, json: bool) -> None:
    """Print and draw two datasets side by side."""
    from candata.datasets.compare import compare, episodes_compared

    with console.progress("reading episodes", episodes_compared(data) + episodes_compared(reference)) as advance:
        comparison = compare(data, reference, lambda: advance(1))
    if html is not None:
        from candata.datasets.writing import write_text
        from candata.reports.comparison import page

        write_text(html, page(comparison))
        console.note(f"{html}: {html.stat().st_size / 1e6:.2f} MB")
    if json:
        console.out_json(comparison.comparison.model_dump(mode="json"))
    else:
        _print_comparison(comparison.comparison)


def _print_summary(summary: Summary, meta: EpisodeMeta | None) -> None:
    """Print the summary for people."""
    console.out(f"{summary.name}@{summary.digest[:12]}  version {summary.version} of {summary.versions}")
    if meta is not None:
        labels = (meta.source, meta.scene, meta.object, meta.task, meta.outcome)
        console.out(f"episode {meta.id}: {', '.join(filter(None, labels))}, {meta.rate_hz:g} Hz")
        if meta.labels:
            console.out(f"labels: {', '.join(f'{name} {value}' for name, value in meta.labels.items())}")
        if meta.unscaled:
            console.out(f"in the source's own unit: {', '.join(meta.unscaled)}")
    console.out(f"{summary.episodes} episodes, {summary.rows} rows, {summary.duration_s:.1f} s")
    for label in ("sources", "scenes", "objects", "tasks"):
        counts = sorted(getattr(summary, label).items())
        console.out(f"{label}: {', '.join(f'{name} {count}' for name, count in counts) or 'not stated'}")
    for task, outcomes in summary.outcomes.items():
        console.out(f"outcomes{f' of {task}' if task else ''}: {console.shares_text(outcomes)}")
    rows = [
        (
            c.name,
            c.unit,
            " ".join(_shape(s) for s in c.shapes),
            _number(c.low),
            _number(c.high),
            f"{c.invalid_share:.1%}",
            c.episodes,
        )
        for c in summary.channels
    ]
    console.out_table(("channel", "unit", "shape", "min", "max", "invalid", "episodes"), rows)
    _print_contact(summary)
    for step in summary.lineage:
        parents = f" from {', '.join(step.parents)}" if step.parents else ""
        tools = ", ".join(f"{name} {version}" for name, version in sorted(step.tools.items()))
        console.out(f"lineage: {step.operation}{parents}{f' ({tools})' if tools else ''}")


def _print_contact(summary: Summary) -> None:
    """Print shares of contact, collision and phases, as far as they are known."""
    _print_shares("collision", summary.collision_shares)
    _print_shares("collision differs from contact", summary.label_disagreements)
    if summary.contact_share is None:
        console.out("contact: not known")
        return
    tips = "".join(f", {name} {share:.1%}" for name, share in summary.fingertip_contact_shares.items())
    console.out(f"contact: any {summary.contact_share:.1%}{tips}")
    _print_shares("phases", summary.phases or {})


def _print_shares(label: str, shares: dict[str, float]) -> None:
    """Print shares by name; nothing without any."""
    if shares:
        console.out(f"{label}: " + ", ".join(f"{name} {share:.1%}" for name, share in shares.items()))


def _shape(shape: tuple[int, ...]) -> str:
    """Return `(T, 5, 3)`."""
    return f"({', '.join(map(str, ('T', *shape)))})"


def _number(value: float | None) -> str:
    """Return four digits, or a dash."""
    return "-" if value is None else f"{value:.4g}"


def _print_comparison(comparison: DatasetComparison) -> None:
    """Print the rows that differ most for people."""
    from candata.reports.comparison import row_unit, verdict
    from candata.reports.inspection import units_of

    for side in (comparison.this, comparison.against):
        console.out(f"{side.label}@{side.digest[:12]}  {side.compared} of {side.episodes} episodes, {side.rows} rows")
    console.out(verdict(comparison))
    units = units_of({*comparison.this.scenes, *comparison.against.scenes})
    rows = [
        (
            r.statistic,
            r.element or "-",
            row_unit(r, units) or "-",
            _number(r.this.median),
            _number(r.against.median),
            _number(r.distance),
            _number(r.luck),
            _number(r.spreads),
            {True: "yes", False: "no", None: "?"}[r.differs],
        )
        for r in comparison.rows[:SHOWN_ROWS]
    ]
    head = (
        "statistic",
        "of",
        "unit",
        comparison.this.label,
        comparison.against.label,
        "distance",
        "luck",
        "spreads",
        "differs",
    )
    console.out_table(head, rows)
    if len(comparison.rows) > SHOWN_ROWS:
        console.out(f"{len(comparison.rows) - SHOWN_ROWS} more rows: --json, --html")
    for text in (*comparison.unmatched, *comparison.notes):
        console.out(f"note: {text}")
