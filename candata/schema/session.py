"""Records of a recorded session: marks, episodes, and how far the forces drifted."""

from __future__ import annotations

from typing import Literal

from candata.schema.record import Record

MarkKind = Literal["begin", "end", "success", "slip", "drop", "miss", "discard"]
MarkSource = Literal["key", "schedule", "contact", "stop"]
BEGIN, END, DISCARD = "begin", "end", "discard"


class Mark(Record):
    """One mark: when (on the clock of whoever made it) [ns], what, by whom and by which key, and what it did.

    By `stop`, an episode ended with the recording. `episode` is the number of the episode that it fits, null if none;
    `note` says why it changed nothing, or what it replaced.
    """

    time_ns: int
    mark: MarkKind
    by: MarkSource = "key"
    typed: str = ""
    episode: int | None = None
    note: str = ""


class SessionEpisode(Record):
    """One episode of a session: `number` counts from 1 by its begin; `end_ns` is null where no end was marked."""

    number: int
    begin_ns: int
    end_ns: int | None = None
    outcome: str | None = None
    discarded: bool = False


class DriftCheck(Record):
    """The force of each fingertip at rest after a session less that before [N]: |x| + |y| + |z| of the change.

    `noise_N` is what the change may be without any drift; `beyond_noise` names the fingertips that changed by more.
    `problem` says why nothing was measured, and is empty where something was.
    """

    change_N: dict[str, float] = {}
    noise_N: dict[str, float] = {}
    beyond_noise: tuple[str, ...] = ()
    problem: str = ""


class SessionFile(Record):
    """`session.json`: the marks and episodes of the log beside it; times are unix nanoseconds.

    The log holds the same events: the file can be made again from it.
    """

    log: str
    session: str
    marks: tuple[Mark, ...]
    episodes: tuple[SessionEpisode, ...]
    drift: DriftCheck | None = None
