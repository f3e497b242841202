"""What generate-sim prints at its end: the version, outcomes, what was left out; and what a set would take."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from candata_cli import console

if TYPE_CHECKING:
    from candata.schema.manifest import VersionFile
    from candata.schema.quarantine import QuarantinedEpisode
    from candata.simulate.forecast import Forecast


def tell_set(out: Path, version: VersionFile, json: bool) -> None:
    """Print what a dataset holds now, by task and outcome, and what was left out of it."""
    from candata.datasets import open_dataset
    from candata.datasets.quarantine import QUARANTINE, read_quarantine

    data = open_dataset(out, version.number)
    ids = set(data.ids)
    left_out = [episode for name, episode in read_quarantine(out).items() if name not in ids]
    outcomes = _outcomes_by_task(data.catalog(("task", "outcome")).to_pylist())
    if json:
        console.out_json(
            {
                "dataset": str(out),
                "version": version.number,
                "digest": version.digest,
                "episodes": len(ids),
                "outcomes": outcomes,
                "quarantined": [episode.model_dump(mode="json") for episode in left_out],
            }
        )
    else:
        console.out(f"{out}: {len(ids)} episodes in version {version.number}, digest {version.digest[:12]}")
    for task, counts in outcomes.items():
        console.note(f"outcomes of {task}: {console.shares_text(counts)}")
    if left_out:
        console.note(f"left out: {len(left_out)} episodes, each with its reason in {out / QUARANTINE}")
        for text in _reasons(left_out):
            console.note(f"  {text}")


def _outcomes_by_task(rows: list[dict]) -> dict[str, dict[str, int]]:
    """Return how many episodes of each task ended with each outcome, of rows of the catalog; those without left out."""
    by_task: dict[str, Counter[str]] = {}
    for row in rows:
        if row["outcome"] is not None:
            by_task.setdefault(row["task"] or "no task", Counter())[row["outcome"]] += 1
    return {task: dict(by_task[task]) for task in sorted(by_task)}


def _reasons(left_out: list[QuarantinedEpisode]) -> list[str]:
    """Return each problem with how many episodes have it, and what was found in the first."""
    by_problem: dict[str, list[QuarantinedEpisode]] = {}
    for episode in left_out:
        by_problem.setdefault(episode.problem, []).append(episode)
    return [
        f"{problem}: {len(episodes)}, first {episodes[0].id} ({episodes[0].found or episodes[0].task})"
        for problem, episodes in by_problem.items()
    ]


def tell_forecast(forecast: Forecast, json: bool) -> None:
    """Print what a set would take."""
    if json:
        console.out_json(forecast.model_dump(mode="json"))
        return
    for label, counts in (("tasks", forecast.tasks), ("objects", forecast.objects)):
        console.out(f"{label}: {', '.join(f'{name} {count}' for name, count in sorted(counts.items())) or 'none'}")
    if forecast.steps is None or forecast.minutes is None or forecast.gigabytes is None:
        console.out(f"{forecast.episodes} episodes; every one of the trial was left out, so the rest is not known")
        return
    console.out(f"{forecast.episodes} episodes, {forecast.rows} rows, {forecast.steps} steps of physics")
    processes = f"{forecast.workers} process{'' if forecast.workers == 1 else 'es'}"
    console.out(
        f"{console.duration(60 * forecast.minutes)} with {processes}, {forecast.gigabytes:.3g} GB "
        f"(measured on {forecast.trial_episodes} episodes)"
    )
