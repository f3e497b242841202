"""What a running recording looks like: a panel for terminals, a line for everything else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from candata.record.recorder_values import RecorderView, StreamView
from candata.record.session_run import SessionView

#: Force at which a bar is full [N].
_FULL_N = 10.0
_BAR_CELLS = 20
_NOTES, _COLUMNS = 3, 3
_WORDS = {"requests_without_reply": "no reply"}
_PHASES = {
    "waiting": ("waiting for frames", "yellow"),
    "calibrating": ("calibrating: do not touch the hand", "yellow"),
    "recording": ("recording", "green"),
    "unplugged": ("unplugged: waiting for the port", "red"),
    "checking": ("checking for drift: do not touch the hand", "yellow"),
}


def panel(view: RecorderView, title: str, notes: Sequence[str] = ()) -> RenderableType:
    """Return the panel of a view: rate, losses, a bar and a contact light for each fingertip, the newest notes."""
    words, colour = _PHASES[view.phase]
    head = Text.assemble(
        ("● ", colour),
        (words, f"bold {colour}"),
        f"   {_clock(view.elapsed_s)}   {view.frames['state']} states   {view.size_bytes / 1e6:.1f} MB",
    )
    parts: list[RenderableType] = [head, _rate(view), Text(), _fingertips(view), Text(), _losses(view)]
    parts += [Text(), _streams(view.streams)] if view.streams else []
    parts += [Text(), *_session(view.session)] if view.session is not None else []
    parts += [Text(), *(Text(note, style="dim") for note in notes[-_NOTES:])] if notes else []
    return Panel(Group(*parts), title=title, subtitle="Ctrl-C ends it and finishes the file", width=78, padding=(1, 2))


def line(view: RecorderView) -> str:
    """Return a view as one line of plain text."""
    force = " ".join(
        f"{name}={total:.1f}{'*' if is_touched else ''}"
        for name, total, is_touched in zip(view.fingertip_names, _total_N(view), view.contact, strict=True)
    )
    streams = "".join(f" | {stream.name}: {_stream_text(stream)}" for stream in view.streams)
    return (
        f"{_clock(view.elapsed_s)} {view.phase}: {view.rate_hz:.0f} Hz, {view.frames['state']} states, "
        f"{view.gaps} gaps, {_loss_text(view)}, {view.size_bytes / 1e6:.1f} MB | N: {force}{streams}"
        + (f" | {_episode_text(view.session)}" if view.session is not None else "")
    )


def _rate(view: RecorderView) -> Text:
    is_full_rate = view.rate_hz >= 0.9 * view.nominal_hz
    return Text.assemble(
        "  ",
        (f"{view.rate_hz:.0f} Hz", "bold green" if is_full_rate else "bold red"),
        f" of {view.nominal_hz:.0f}   {view.frames['command']} commands",
    )


def _fingertips(view: RecorderView) -> Table:
    """Return a row for each fingertip: its light, its force as a bar and in newton."""
    table = Table(box=None, padding=(0, 1), show_header=True, header_style="dim")
    for column in ("fingertip", "contact", "force", "N", "x", "y", "z"):
        table.add_column(column, justify="right" if column in "Nxyz" else "left", no_wrap=True)
    rows = zip(view.fingertip_names, view.force_N, _total_N(view), view.contact, strict=True)
    for name, force, total, is_touched in rows:
        light = Text("● touch", style="bold green") if is_touched else Text("○", style="dim")
        cells = min(_BAR_CELLS, round(float(total) / _FULL_N * _BAR_CELLS))
        bar = Text("█" * cells, style="cyan") + Text("·" * (_BAR_CELLS - cells), style="dim")
        table.add_row(name, light, bar, f"{total:.1f}", *(f"{axis:+.1f}" for axis in force))
    return table


def _session(session: SessionView) -> list[Text]:
    """Return the episodes by outcome, the newest marks and the keys."""
    judged = [episode for episode in session.episodes if not episode.discarded]
    counts = Counter(episode.outcome or "not judged" for episode in judged)
    discarded = len(session.episodes) - len(judged)
    counts_text = "   ".join(f"{count} {words}" for words, count in counts.items())
    is_running = session.running_s is not None
    head = Text.assemble(
        ("● " if is_running else "○ ", "bold green" if is_running else "dim"),
        (_episode_text(session), "bold" if is_running else ""),
        f"   {counts_text}" + (f"   {discarded} discarded" if discarded else ""),
    )
    return [head, *(Text(f"  {mark}") for mark in session.marks), Text(session.keys, style="dim")]


def _episode_text(session: SessionView) -> str:
    """Return which episode is under way, or how many there are."""
    count, planned = len(session.episodes), f" of {session.planned}" if session.planned else ""
    if session.running_s is not None:
        return f"episode {count}{planned}: {session.running_s:.1f} s"
    return f"{count}{planned} episodes"


def _losses(view: RecorderView) -> Table:
    """Return the counts of what went wrong, the ones that happened in colour."""
    table = Table.grid(padding=(0, 1))
    loss_counts = {_WORDS.get(kind, kind): count for kind, count in view.losses.items()}
    counts = {"gaps": view.gaps, **loss_counts, **{f"saturated_{kind}": n for kind, n in view.saturated.items()}}
    cells = [Text(f"{n:>6} {kind.replace('_', ' ')}", style="bold red" if n else "dim") for kind, n in counts.items()]
    for at in range(0, len(cells), _COLUMNS):
        table.add_row(*cells[at : at + _COLUMNS])
    return table


def _streams(streams: Sequence[StreamView]) -> Table:
    """Return a row for each stream beside the hand: rate, frames, gaps, losses or silence."""
    table = Table(box=None, padding=(0, 1), show_header=True, header_style="dim")
    for column in ("stream", "Hz", "of", "frames", "gaps", "lost"):
        table.add_column(column, justify="left" if column in ("stream", "lost") else "right", no_wrap=True)
    for stream in streams:
        is_well = stream.phase == "recording" and stream.rate_hz >= 0.9 * stream.nominal_hz
        table.add_row(
            stream.name,
            Text(f"{stream.rate_hz:.0f}", style="bold green" if is_well else "bold red"),
            f"{stream.nominal_hz:.0f}",
            str(stream.frames),
            Text(str(stream.gaps), style="bold red" if stream.gaps else "dim"),
            _loss_text(stream) if stream.phase == "recording" else Text(_silence_text(stream), style="bold red"),
        )
    return table


def _stream_text(stream: StreamView) -> str:
    """Return a stream in a few words of plain text."""
    state = _loss_text(stream) if stream.phase == "recording" else _silence_text(stream)
    return f"{stream.rate_hz:.0f} Hz, {stream.frames} frames, {stream.gaps} gaps, {state}"


def _silence_text(stream: StreamView) -> str:
    return f"{stream.phase} for {stream.silent_s:.1f} s"


def _loss_text(view: RecorderView | StreamView) -> str:
    """Return the losses that happened, in words."""
    loss_texts = [f"{count} {kind.replace('_', ' ')}" for kind, count in view.losses.items() if count]
    return ", ".join(loss_texts) or "nothing lost"


def _total_N(view: RecorderView) -> np.ndarray:
    return np.abs(view.force_N).sum(axis=-1)


def _clock(seconds: float) -> str:
    total_s = int(seconds)
    return f"{total_s // 3600}:{total_s // 60 % 60:02d}:{total_s % 60:02d}"
