"""The page of a dataset: channels, distributions, contact, a few episodes whole, lineage."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape

from candata.datasets.elements import JOINT_UNITS
from candata.datasets.summary import ChannelSummary, Summary
from candata.datasets.survey import ExampleEpisode, Survey
from candata.reports import space, traces
from candata.reports.distributions import distributions
from candata.reports.document import document, figure
from candata.reports.joint_units import joint_units, readable
from candata.reports.numbers import digits, percent
from candata.reports.seeing_style import SEEING_STYLE, TURN_SCRIPT
from candata.reports.tables import table
from candata.schema.channels import CHANNELS
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage

DASH = "\N{EN DASH}"
#: Names listed of what a dataset counts (scenes, objects, tasks), the most frequent first.
MOST_NAMES = 8
#: Steps listed of a lineage, the last ones.
MOST_STEPS = 20


def page(found: Survey, episode: str | None = None) -> str:
    """Return the page as text.

    Parameters
    ----------
    found : Survey
        Of the dataset, or of the one episode.
    episode : str, optional
        Id of the one episode that the page is about.
    """
    summary = found.summary
    units = units_of(summary.scenes)
    title = episode or summary.name
    body = "".join(
        (
            _head(summary, episode),
            _answers(summary),
            "<h2>Channels</h2>",
            _channels(summary.channels, units),
            _contact(summary),
            _episodes(found.examples, episode),
            "<h2>Distributions</h2>",
            f'<p class="sub">Valid values of {_of(summary, episode)}; a bar\'s height is its share of them.</p>',
            distributions(found.distributions, units),
            _left_out(found),
            "<h2>Where it comes from</h2>",
            lineage(summary.lineage),
        )
    )
    return document(title, "none", body, TURN_SCRIPT, SEEING_STYLE)


def units_of(scenes: Iterable[str]) -> dict[str, str]:
    """Return the units of the joints of all scenes that are built in; of a joint they disagree on, nothing."""
    merged: dict[str, str] = {}
    clash: set[str] = set()
    for scene in scenes:
        for name, unit in joint_units(scene).items():
            clash |= {name} if merged.setdefault(name, unit) != unit else set()
    return {name: unit for name, unit in merged.items() if name not in clash}


def lineage(steps: tuple[Lineage, ...]) -> str:
    """Return how the episodes came to be, one row a step."""
    rows = [
        (
            step.operation, ", ".join(step.parents) or DASH,
            ", ".join(f"{k} {v}" for k, v in sorted(step.tools.items())) or DASH, step.revision or DASH,
            ", ".join(f"{k} {v}" for k, v in sorted(step.details.items()) if isinstance(v, str | int | float)) or DASH,
        )
        for step in steps[-MOST_STEPS:]
    ]  # fmt: skip
    early = len(steps) - MOST_STEPS
    note = f'<p class="note">{early} earlier steps are not listed.</p>' if early > 0 else ""
    return table(("operation", "from", "tools", "revision", "details"), rows) + note


def _head(summary: Summary, episode: str | None) -> str:
    """Return the name, large, and what it is."""
    where = f"{summary.name}@{summary.digest[:12]}, version {summary.version} of {summary.versions}"
    kicker = f"One episode of {where}" if episode else f"Dataset {where}"
    counted = (f"{label}: {_counted(getattr(summary, label))}" for label in ("sources", "scenes", "objects", "tasks"))
    return (
        f'<header><p class="kicker">{escape(kicker)}</p><h1>{escape(episode or summary.name)}</h1>'
        f'<p class="meaning">{escape("; ".join(counted))}.</p></header>'
    )


def _counted(counts: Mapping[str, int]) -> str:
    """Return names with their counts, the most frequent first."""
    order = sorted(counts.items(), key=lambda pair: (-pair[1], pair[0]))
    more = len(order) - MOST_NAMES
    listed = [f"{name} {count}" for name, count in order[:MOST_NAMES]] + ([f"{more} more"] if more > 0 else [])
    return ", ".join(listed) or "not stated"


def _answers(summary: Summary) -> str:
    """Return four numbers in words."""
    worst = max(summary.channels, key=lambda c: c.invalid_share, default=None)
    lost = [c for c in summary.channels if c.invalid_share > 0]
    gaps = "Every channel is valid in every row." if worst is None or not lost else (
        f"of {worst.name}, the most of any; {len(lost)} of {len(summary.channels)} channels have gaps."
    )  # fmt: skip
    touch = summary.contact_share
    several = f"{_noun(summary.episodes, 'episode')}, {digits(summary.duration_s / summary.episodes)} s in the mean."
    entries = [
        ("How much?", f"{summary.episodes:,}", several),
        ("How long?", _duration(summary.duration_s), f"{summary.rows:,} {_noun(summary.rows, 'row')}{_rate(summary)}."),
        ("In contact?", DASH if touch is None else percent(touch),
         "No channel says." if touch is None else "of the rows: at least one fingertip touches."),
        ("Invalid?", percent(worst.invalid_share) if worst and lost else "nothing", gaps),
    ]  # fmt: skip
    cells = (
        f'<div><dt>{q}</dt><dd><span class="lead big">{escape(lead)}</span>{escape(text)}</dd></div>'
        for q, lead, text in entries
    )
    return f'<dl class="answers">{"".join(cells)}</dl>'


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


def _of(summary: Summary, episode: str | None) -> str:
    """Return what a figure is over."""
    return "this episode" if episode or summary.episodes == 1 else f"all {summary.episodes:,} episodes"


def _channels(channels: tuple[ChannelSummary, ...], units: Mapping[str, str]) -> str:
    """Return the table of channels."""
    rows = [
        (
            c.name, _unit(c, units), " ".join(f"({', '.join(map(str, ('T', *s)))})" for s in c.shapes),
            _number(c.low), _number(c.high), percent(c.invalid_share), f"{c.episodes:,}", CHANNELS[c.name].meaning,
        )
        for c in channels
    ]  # fmt: skip
    head = ("channel", "unit", "shape", "min", "max", "invalid", "episodes", "meaning")
    return f'<div class="channels">{table(head, rows, numeric=(3, 4, 5, 6), whole=(1, 2))}</div>'


def _unit(channel: ChannelSummary, units: Mapping[str, str]) -> str:
    """Return the unit of a channel, every unit that its joints have."""
    if channel.name not in JOINT_UNITS:
        return channel.unit
    found = sorted({readable(JOINT_UNITS[channel.name], name, units) for name in units}, reverse=True)
    return ", ".join(found) or readable(JOINT_UNITS[channel.name], "", units)


def _number(value: float | None) -> str:
    """Return a few digits, or a dash."""
    return DASH if value is None else digits(value)


def _contact(summary: Summary) -> str:
    """Return shares of phases and of each fingertip's contact; a sentence where they are not known."""
    if summary.contact_share is None or summary.phases is None:
        return "<h2>Contact</h2><p>Not known: no channel says when the object is touched.</p>"
    bar = "".join(f'<i class="{name}" style="width:{100 * v:.2f}%"></i>' for name, v in summary.phases.items())
    words = ", ".join(f"{name} {percent(v)}" for name, v in summary.phases.items())
    left = figure(
        "Phases", f"Share of rows: {words}. Onset is the first 100 ms of a touch, release the 100 ms around its loss.",
        f'<div class="shares" aria-hidden="true">{bar}</div>{traces.phase_key(False)}',
    )  # fmt: skip
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td><i style="width:{100 * v:.1f}%"></i></td>'
        f'<td class="n">{percent(v)}</td></tr>'
        for name, v in (summary.fingertip_contact_shares or {"any": summary.contact_share}).items()
    )
    right = figure("Fingertips", "Share of rows in which each touches.", f'<table class="tips">{rows}</table>')
    return f'<h2>Contact</h2><div class="two">{left}{right}</div>'


def _episodes(shown: tuple[ExampleEpisode, ...], episode: str | None) -> str:
    """Return the chosen episodes whole, under what they were chosen by."""
    if episode is not None:
        return "".join(_episode(one.episode) for one in shown[:1])
    rule = (
        "Chosen by a fixed rule: the first by id, the longest, and the one with the largest share of rows in contact."
    )
    cells = "".join(
        f'<section class="episode"><h3>{escape(one.episode.meta.id)}</h3><p class="sub">{escape(_facts(one))}</p>'
        f"{_episode(one.episode)}</section>"
        for one in shown
    )
    return f'<h2>Episodes</h2><p class="sub">{rule}</p>{cells}'


def _facts(one: ExampleEpisode) -> str:
    """Return what an episode is, in one line."""
    meta = one.episode.meta
    said = [meta.source, meta.task, meta.object, f"seed {meta.seed}" if meta.seed is not None else None, meta.outcome]
    length = f"{len(one.episode):,} {_noun(len(one.episode), 'row')} in {digits(float(one.episode.time_s[-1]))} s"
    return f"{one.reason[0].upper()}{one.reason[1:]}; {length}; {', '.join(filter(None, said))}."


def _episode(episode: Episode) -> str:
    """Return the figures of one episode; a part that it has no channel for is left out, and said."""
    units = joint_units(episode.meta.scene)
    path, contact, force = space.path(episode), traces.timeline(episode), traces.forces(episode)
    joints = traces.joints(episode, units)
    beside = f"<h4>Contact</h4>{contact}" if contact else ""
    beside += f"<h4>Forces</h4>{force}" if force else ""
    parts = f'<div class="pair">{_space(path)}<div>{beside}</div></div>' if path and beside else _space(path) + beside
    parts += f"<h4>Joints and commands</h4>{joints}" if joints else ""
    said = {"valid pose of an object": path, "contact": contact, "forces": force, "joints": joints}
    absent = [name for name, drawn in said.items() if not drawn]
    return parts + (f'<p class="note">This episode has no {", no ".join(absent)}.</p>' if absent else "")


def _space(path: str) -> str:
    """Return the object's path under its key; empty for none."""
    key = [("way", "path"), ("held", "in contact"), ("start", "start"), ("end", "end"), *_axes()]
    spans = "".join(f'<span class="key-{kind}">{name}</span>' for kind, name in key)
    note = '<p class="note turn">Drag to turn.</p>'
    return f'<div><h4>Object in space</h4><p class="sub key">{spans}</p>{path}{note}</div>' if path else ""


def _axes() -> list[tuple[str, str]]:
    """Return the key of the object's axes."""
    return [(f"axis-{axis}", f"its {axis}") for axis in "xyz"]


def _left_out(found: Survey) -> str:
    """Return how many sets of elements have no histograms; empty for none."""
    if not found.sets_left_out:
        return ""
    return f'<p class="note">{found.sets_left_out} more sets of joints or fingertips have no histograms.</p>'
