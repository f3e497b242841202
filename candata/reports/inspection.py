"""The page of a dataset: channels, contact, all episodes in a list and to play, distributions, lineage."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from candata.datasets.elements import JOINT_UNITS
from candata.datasets.summary import ChannelSummary, Summary
from candata.datasets.survey import EpisodeFacts, Survey
from candata.reports import space, traces
from candata.reports.distributions import distributions
from candata.reports.document import render_page
from candata.reports.joint_units import joint_units, readable_unit
from candata.reports.numbers import digits, percent
from candata.reports.playback import Playbacks, facts_text
from candata.schema.channels import CHANNELS
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage

DASH = "\N{EN DASH}"
#: Names listed of what a dataset counts (scenes, objects, tasks), the most frequent first.
MOST_NAMES = 8
#: Episodes listed; of more the first by id are.
MOST_LISTED = 10_000
#: Steps listed of a lineage, the last ones.
MOST_STEPS = 20
#: Class and name of what the drawing of a path shows.
PATH_KEY = (
    ("key-way", "path"),
    ("key-held", "in contact"),
    ("key-start", "start"),
    ("key-end", "end"),
    *((f"key-axis-{axis}", f"its {axis}") for axis in "xyz"),
)


@dataclass(frozen=True)
class EpisodeFigures:
    """What the page shows of an episode: its figures, empty where it has no channel for them, and what it lacks."""

    facts: str
    path: Markup
    contact: Markup
    forces: Markup
    joints: Markup
    absent: tuple[str, ...]


@dataclass(frozen=True)
class ListedEpisode:
    """A row of the list: its number, its cells as text with the number that they are sorted by, and what opens it."""

    number: int
    cells: tuple[tuple[str, float | None], ...]
    is_playable: bool


def page(survey: Survey, playbacks: Playbacks, episode: Episode | None = None) -> str:
    """Return the page as text.

    Parameters
    ----------
    survey : Survey
        Of the dataset, or of the one episode.
    playbacks : Playbacks
        The same episodes, to play.
    episode : Episode, optional
        The one episode that the page is about.
    """
    summary = survey.summary
    units = units_of(summary.scenes)
    title = summary.name if episode is None else episode.meta.id
    names, rows = _episode_list(survey.episodes[:MOST_LISTED], playbacks)
    return render_page(
        "inspection",
        title=title,
        tone="none",
        kicker=_kicker(summary, episode is not None),
        meaning=_meaning(summary),
        answers=_answers(summary),
        channels=[_channel_row(channel, units) for channel in summary.channels],
        outcomes=_outcome_rows(summary.outcomes),
        contact_known=summary.contact_share is not None and summary.phases is not None,
        phases=summary.phases or {},
        phase_key=traces.phase_key(False),
        fingertips=summary.fingertip_contact_shares or {"any": summary.contact_share},
        figures=None if episode is None else _episode_figures(episode),
        path_key=PATH_KEY,
        columns=names,
        listed=rows,
        unlisted_count=len(survey.episodes) - len(rows),
        unplayable_count=len(survey.episodes) - len(playbacks.episodes),
        geometries=[(name, Markup(text)) for name, text in playbacks.geometries.items()],
        playbacks=[
            (number, Markup(playbacks.episodes[facts.id]))
            for number, facts in enumerate(survey.episodes)
            if facts.id in playbacks.episodes
        ],
        scope="this episode" if episode or summary.episodes == 1 else f"all {summary.episodes:,} episodes",
        distributions=distributions(survey.distributions, units),
        sets_left_out=survey.sets_left_out,
        lineage=_lineage_rows(summary.lineage),
        unlisted_steps=max(len(summary.lineage) - MOST_STEPS, 0),
    )


def units_of(scenes: Iterable[str]) -> dict[str, str]:
    """Return the units of the joints of all scenes that are built in; of a joint they disagree on, nothing."""
    units: dict[str, str] = {}
    contradictory: set[str] = set()
    for scene in scenes:
        for name, unit in joint_units(scene).items():
            contradictory |= {name} if units.setdefault(name, unit) != unit else set()
    return {name: unit for name, unit in units.items() if name not in contradictory}


def _lineage_rows(steps: tuple[Lineage, ...]) -> list[tuple[str, ...]]:
    """Return how the episodes came to be, one row a step."""
    rows = []
    for step in steps[-MOST_STEPS:]:
        tools = ", ".join(f"{name} {version}" for name, version in sorted(step.tools.items()))
        details = (f"{k} {v}" for k, v in sorted(step.details.items()) if isinstance(v, str | int | float))
        cells = (", ".join(step.parents), tools, step.revision, ", ".join(details))
        rows.append((step.operation, *(cell or DASH for cell in cells)))
    return rows


def _kicker(summary: Summary, is_one_episode: bool) -> str:
    """Return the version that the page is about."""
    version = f"{summary.name}@{summary.digest[:12]}, version {summary.version} of {summary.versions}"
    return f"One episode of {version}" if is_one_episode else f"Dataset {version}"


def _meaning(summary: Summary) -> str:
    """Return what the episodes are of."""
    labels = ("sources", "scenes", "objects", "tasks")
    return "; ".join(f"{label}: {_counts(getattr(summary, label))}" for label in labels) + "."


def _counts(counts: Mapping[str, int]) -> str:
    """Return names with their counts, the most frequent first."""
    order = sorted(counts.items(), key=lambda pair: (-pair[1], pair[0]))
    unlisted_count = len(order) - MOST_NAMES
    entries = [f"{name} {count}" for name, count in order[:MOST_NAMES]]
    return ", ".join([*entries, *([f"{unlisted_count} more"] if unlisted_count > 0 else [])]) or "not stated"


def _answers(summary: Summary) -> list[tuple[str, str, str]]:
    """Return four questions, each with a number and a sentence."""
    gap_channels = [channel for channel in summary.channels if channel.invalid_share > 0]
    worst_channel = max(gap_channels, key=lambda channel: channel.invalid_share, default=None)
    gaps = "Every channel is valid in every row."
    if worst_channel is not None:
        count = f"{len(gap_channels)} of {len(summary.channels)}"
        gaps = f"of {worst_channel.name}, the most of any; {count} channels have gaps."
    touch = summary.contact_share
    contact = "No channel says." if touch is None else "of the rows: at least one fingertip touches."
    mean_s = digits(summary.duration_s / summary.episodes)
    return [
        ("How much?", f"{summary.episodes:,}", f"{_noun(summary.episodes, 'episode')}, {mean_s} s in the mean."),
        ("How long?", _duration(summary.duration_s), f"{summary.rows:,} {_noun(summary.rows, 'row')}{_rate(summary)}."),
        ("In contact?", DASH if touch is None else percent(touch), contact),
        ("Invalid?", "nothing" if worst_channel is None else percent(worst_channel.invalid_share), gaps),
    ]


def _rate(summary: Summary) -> str:
    """Return rows a second, from steps over time; empty where no episode has two rows."""
    steps = summary.rows - summary.episodes
    return f", {digits(steps / summary.duration_s)} a second" if summary.duration_s > 0 else ""


def _noun(count: int, name: str) -> str:
    """Return a noun in the number that goes with a count."""
    return name if count == 1 else f"{name}s"


def _duration(seconds: float) -> str:
    """Return seconds, minutes or hours."""
    if seconds < 120:
        return f"{digits(seconds)} s"
    return f"{digits(seconds / 60)} min" if seconds < 7200 else f"{digits(seconds / 3600)} h"


def _channel_row(channel: ChannelSummary, units: Mapping[str, str]) -> tuple[str, ...]:
    """Return the row of a channel."""
    shapes = " ".join(f"({', '.join(map(str, ('T', *shape)))})" for shape in channel.shapes)
    low, high = (DASH if value is None else digits(value) for value in (channel.low, channel.high))
    invalid, episodes = percent(channel.invalid_share), f"{channel.episodes:,}"
    meaning = CHANNELS[channel.name].meaning
    return channel.name, _unit(channel, units), shapes, low, high, invalid, episodes, meaning


def _unit(channel: ChannelSummary, units: Mapping[str, str]) -> str:
    """Return the unit of a channel, every unit that its joints have."""
    if channel.name not in JOINT_UNITS:
        return channel.unit
    unit = JOINT_UNITS[channel.name]
    joint_unit_names = sorted({readable_unit(unit, name, units) for name in units}, reverse=True)
    return ", ".join(joint_unit_names) or readable_unit(unit, "", units)


def _outcome_rows(by_task: Mapping[str, Mapping[str, int]]) -> list[tuple[str, ...]]:
    """Return one row for each task and outcome: how many episodes, and their share of the task's."""
    return [
        (task or DASH, outcome, f"{count:,}", percent(count / sum(counts.values())))
        for task, counts in by_task.items()
        for outcome, count in sorted(counts.items(), key=lambda pair: (-pair[1], pair[0]))
    ]


def _episode_list(episodes: Sequence[EpisodeFacts], playbacks: Playbacks) -> tuple[list[str], list[ListedEpisode]]:
    """Return heads and rows of the list of episodes; labels that no episode has are left out."""
    labels = [
        name for name in ("source", "scene", "object", "task", "outcome") if any(getattr(e, name) for e in episodes)
    ]
    rows = []
    for number, facts in enumerate(episodes):
        cells: list[tuple[str, float | None]] = [(facts.id, None)]
        cells += [(getattr(facts, name) or DASH, None) for name in labels]
        cells += [(f"{facts.rows:,}", facts.rows), (digits(facts.duration_s), facts.duration_s)]
        contact = DASH if facts.contact_share is None else percent(facts.contact_share)
        cells += [(contact, facts.contact_share or 0.0), (percent(facts.invalid_share), facts.invalid_share)]
        rows.append(ListedEpisode(number, tuple(cells), facts.id in playbacks.episodes))
    return ["episode", *labels, "rows", "seconds", "in contact", "invalid rows"], rows


def _episode_figures(episode: Episode) -> EpisodeFigures:
    """Return the figures of one episode, and what it has no channel for."""
    path, contact, forces = space.path(episode), traces.timeline(episode), traces.forces(episode)
    joints = traces.joints(episode, joint_units(episode.meta.scene))
    figures = {"valid pose of an object": path, "contact": contact, "forces": forces, "joints": joints}
    return EpisodeFigures(
        facts=facts_text(episode),
        path=path,
        contact=contact,
        forces=forces,
        joints=joints,
        absent=tuple(name for name, figure in figures.items() if not figure),
    )
