"""From a session's log to its episodes: rows between begin and end, with the outcome that was marked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from candata.errors import DataError, Where
from candata.record.drift import drift_text
from candata.record.importing import ImportedLog
from candata.record.logs import Log
from candata.record.session_run import session_of
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Episode
from candata.schema.session import SessionEpisode

#: Fewest rows of an episode: a rate needs two.
FEWEST_ROWS = 2


@dataclass(frozen=True, eq=False)
class ImportedSession:
    """The episodes of a session, `details` as plain data for the lineage, and notes for people, a line each."""

    episodes: tuple[Episode, ...]
    details: dict[str, Any]
    notes: tuple[str, ...]


def cut_episodes(whole: ImportedLog, log: Log) -> ImportedSession:
    """Return the episodes that were marked in a log; the whole log as one where it is of no session.

    The n-th begin of a session makes the episode `ID-000n`, with the id of the whole: discarding one renames none, nor
    do marks that are lost with a damaged piece of the log. The last episode reaches to the end of the log where it has
    no end; another one whose begin or end is lost is left out.

    Parameters
    ----------
    whole : ImportedLog
        The log as one episode.
    log : Log
        The log itself.

    Raises
    ------
    DataError
        When it is of a session and no episode is left, or an event is damaged.
    """
    if not log.meta.session and not log.events:
        return ImportedSession((whole.episode,), whole.details, whole.notes)
    session, drift = session_of(log)
    newest = max((mark.episode for mark in session.marks if mark.episode is not None), default=0)
    whole_numbers = {e.number for e in session.episodes if e.end_ns is not None or e.number == newest}
    lost = set(range(1, newest + 1)) - whole_numbers
    kept = [episode for episode in session.episodes if not (episode.discarded or episode.number in lost)]
    cuts = [(episode, _cut(whole.episode, episode)) for episode in kept]
    notes, episodes = list(whole.notes), [episode for _, episode in cuts if episode is not None]
    empty = [str(episode.number) for episode, rows in cuts if rows is None]
    discarded = [str(episode.number) for episode in session.episodes if episode.discarded]
    unended = [str(episode.number) for episode in kept if episode.end_ns is None]
    notes += [f"discarded episodes left out: {', '.join(discarded)}"] if discarded else []
    lost_text = ", ".join(map(str, sorted(lost)))
    notes += [f"left out, the log lacks their begin or end: episodes {lost_text}"] if lost else []
    notes += [f"left out, without rows that all streams cover: episodes {', '.join(empty)}"] if empty else []
    notes += [f"no end was marked, the end of the log counts: episode {', '.join(unended)}"] if unended else []
    notes += [f"a mark that fits no episode: {mark.note}" for mark in session.marks if mark.episode is None]
    notes += [] if drift is None else [drift_text(drift)]
    if not episodes:
        raise DataError(
            "no episode is left of the session",
            expected="a begin mark whose episode is not discarded and has rows",
            found=f"{len(session.marks)} marks, {len(session.episodes)} episodes, {len(discarded)} discarded",
            where=Where(path=str(whole.details["log"])),
            fix="mark episodes while you record: the space bar, --episodes or --start-on-contact",
        )
    details = whole.details | {
        "session": log.meta.session,
        "episodes": [episode.model_dump(mode="json") for episode in session.episodes],
        "drift": None if drift is None else drift.model_dump(mode="json"),
    }
    return ImportedSession(tuple(episodes), details, tuple(notes))


def _cut(whole: Episode, marked: SessionEpisode) -> Episode | None:
    """Return the rows of one episode, None where too few are there."""
    time_ns = whole["time_ns"]
    end_ns = int(time_ns[-1]) if marked.end_ns is None else marked.end_ns
    begin, end = (int(k) for k in np.searchsorted(time_ns, [marked.begin_ns, end_ns + 1]))
    if end - begin < FEWEST_ROWS:
        return None
    arrays = {name: values[begin:end] for name, values in whole.arrays.items()}
    flags = {name: name.removesuffix(VALID_SUFFIX) for name in arrays if name.endswith(VALID_SUFFIX)}
    invalid = {channel: int((~arrays[name]).sum()) for name, channel in flags.items() if not arrays[name].all()}
    update = {
        "id": f"{whole.meta.id}-{marked.number:04d}",
        "outcome": marked.outcome or whole.meta.outcome,
        "invalid_counts": invalid,
        "labels": {**whole.meta.labels, "session_episode": marked.number},
    }
    kept = {name: values for name, values in arrays.items() if flags.get(name, name) in invalid or name not in flags}
    return Episode(whole.meta.model_copy(update=update), kept)
