"""A session under way: keys, schedule and touch make marks; each is an event of the log, and `session.json` follows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from candata.datasets.writing import write_text
from candata.errors import DataError, UsageError, Where
from candata.record.log_messages import DRIFT, MARK
from candata.record.logs import Log, LogWriter, read_log
from candata.record.session import KEY_WORDS, SPACE, Session, SessionPlan, Touch, due_mark, replay
from candata.schema.record import Record
from candata.schema.session import DriftCheck, Mark, MarkKind, MarkSource, SessionEpisode, SessionFile

_Kind = TypeVar("_Kind", bound=Record)
LOG_NAME, FILE_NAME = "session.mcap", "session.json"
_SHOWN_MARKS = 3
#: Reads keys: returns those that were pressed since, each with its monotonic stamp [ns].
Keys = Callable[[], Sequence[tuple[int, str]]]


@dataclass(frozen=True)
class SessionView:
    """What can be seen of a session.

    Attributes
    ----------
    episodes : tuple of SessionEpisode
        All so far.
    marks : tuple of str
        The newest ones in words.
    running_s : float or None
        How long the episode under way has lasted [s]; None where none is.
    planned : int or None
        How many there are to be.
    keys : str
        What the keys do.
    """

    episodes: tuple[SessionEpisode, ...]
    marks: tuple[str, ...]
    running_s: float | None
    planned: int | None
    keys: str


class RunningSession:
    """Makes marks of a recording, and keeps them in its log and in `session.json` beside it."""

    def __init__(self, plan: SessionPlan, keys: Keys, say: Callable[[str], None], keys_text: str = KEY_WORDS) -> None:
        """Begin without marks; `say` takes notes for people, `keys_text` is shown as what the keys do."""
        self._plan, self._keys, self._say, self._keys_text = plan, keys, say, keys_text
        self._session, self._touch = Session(), Touch()
        self._start_ns: int | None = None
        self._is_over = False
        self._drift: DriftCheck | None = None

    def check(self, fingertip_names: Sequence[str], is_calibrated: bool) -> None:
        """Refuse episodes by contact where no force tells of one.

        Raises
        ------
        UsageError
            When the hand has no fingertips, or their forces at rest are not measured first.
        """
        if not self._plan.on_contact or (fingertip_names and is_calibrated):
            return
        raise UsageError(
            "no episode can begin by contact",
            expected="fingertips whose forces at rest are known",
            found="forces that are not calibrated" if fingertip_names else "a hand without fingertips",
            fix=f"leave out {'--no-calibrate or ' if fingertip_names else ''}--start-on-contact",
        )

    def open(self, writer: LogWriter) -> None:
        """Take the log that the marks go to."""
        self._writer = writer

    @property
    def is_done(self) -> bool:
        """Whether all planned episodes were recorded."""
        return self._plan.is_done(self._session)

    def begin(self, stamp_ns: int) -> None:
        """Let the plan begin episodes from now on: the hand is calibrated."""
        if self._start_ns is None:
            self._start_ns = stamp_ns

    def touched(self, stamps_ns: Sequence[int], flags: NDArray[np.bool_]) -> None:
        """Take contact flags `(n, F) bool` of n readings."""
        for stamp_ns, is_touching in zip(stamps_ns, np.asarray(flags.any(axis=1)), strict=True):
            self._touch = self._touch.seen(stamp_ns, bool(is_touching))
            if self._plan.on_contact:
                self._follow_plan(stamp_ns, "contact")

    def tick(self, now_ns: int) -> None:
        """Take the keys that were pressed, and what the schedule says."""
        self._take_keys()
        if not (self._plan.on_contact or self._is_over):
            self._follow_plan(now_ns, "schedule")

    def stopped(self, now_ns: int) -> None:
        """End the episode under way with the recording: what follows, such as a drift check, is none of it.

        The episodes may still be judged: keys that begin or end one do nothing from now on.
        """
        self._is_over = True
        if self._session.open_episode is not None:
            self._mark("end", now_ns, "stop", "")
        self._take_keys()

    def drifted(self, stamp_ns: int, drift: DriftCheck) -> None:
        """Keep what the drift check gave."""
        self._drift = drift
        self._writer.event(stamp_ns, {"event": DRIFT, **drift.model_dump(mode="json")})
        self._write_file()

    def facts(self) -> dict[str, Any]:
        """Return the episodes and the drift check as plain data, for the report."""
        return {
            "session": self._writer.meta.session,
            "episodes": [episode.model_dump(mode="json") for episode in self._episodes()],
            "stray_marks": sum(mark.episode is None for mark in self._session.marks),
            "drift": None if self._drift is None else self._drift.model_dump(mode="json"),
        }

    def view(self, now_ns: int) -> SessionView:
        """Return what can be seen."""
        running = self._session.open_episode
        return SessionView(
            tuple(self._session.episodes),
            tuple(_mark_text(mark) for mark in self._session.marks[-_SHOWN_MARKS:]),
            None if running is None else max(0.0, (now_ns - running.begin_ns) * 1e-9),
            self._plan.episodes,
            self._keys_text,
        )

    def _take_keys(self) -> None:
        for stamp_ns, key in self._keys():
            mark = self._session.typed(key, stamp_ns)
            if mark is not None and not (self._is_over and key == SPACE):
                self._mark(mark, stamp_ns, "key", "space" if key == SPACE else key)

    def _follow_plan(self, now_ns: int, by: MarkSource) -> None:
        if self._start_ns is None:
            return
        due = due_mark(self._plan, self._session, now_ns, self._start_ns, self._touch)
        if due is not None:
            self._mark(*due, by, "")

    def _mark(self, mark: MarkKind, stamp_ns: int, by: MarkSource, typed: str) -> None:
        kept = self._session.mark(mark, stamp_ns, by, typed)
        self._writer.event(stamp_ns, {"event": MARK, **kept.model_dump(mode="json", exclude={"time_ns"})})
        self._writer.flush()
        self._write_file()
        if kept.note:
            self._say(kept.note)

    def _wall_marks(self) -> list[Mark]:
        """Return the marks in unix nanoseconds."""
        offset_ns = self._writer.meta.wall_offset_ns
        return [mark.model_copy(update={"time_ns": mark.time_ns + offset_ns}) for mark in self._session.marks]

    def _episodes(self) -> list[SessionEpisode]:
        """Return the episodes in unix nanoseconds."""
        return replay(self._wall_marks()).episodes

    def _write_file(self) -> None:
        path, name = self._writer.path, self._writer.meta.session
        write_session_file(path.with_name(FILE_NAME), path.name, name, self._wall_marks(), self._drift)


def write_session_file(
    path: Path, log_name: str, session_name: str, marks: Iterable[Mark], drift: DriftCheck | None
) -> None:
    """Write `session.json`, whole or not at all.

    Raises
    ------
    SetupError
        When it cannot be written.
    """
    session = replay(marks)
    file = SessionFile(
        log=log_name,
        session=session_name,
        marks=tuple(session.marks),
        episodes=tuple(session.episodes),
        drift=drift,
    )
    write_text(path, file.model_dump_json(indent=2) + "\n", "session file")


def restore_session_file(log_path: Path) -> Path | None:
    """Return `NAME.json` beside a log, written anew from its events; None where the log is of no session.

    Raises
    ------
    DataError
        When the file is no log of candata, or an event is damaged.
    SetupError
        When it cannot be written.
    """
    log = read_log(log_path)
    session, drift = session_of(log)
    if not log.meta.session:
        return None
    path = log_path.with_suffix(".json")
    write_session_file(path, log_path.name, log.meta.session, session.marks, drift)
    return path


def log_of(path: Path) -> Path:
    """Return the log that a path names: the one in a session's folder, or the path itself."""
    return path / LOG_NAME if (path / LOG_NAME).is_file() else path


def session_of(log: Log) -> tuple[Session, DriftCheck | None]:
    """Return the session in a log, and its drift check; no marks and None where it has none.

    Raises
    ------
    DataError
        When an event is none that a session writes.
    """
    marks: list[Mark] = []
    drift: DriftCheck | None = None
    for time_ns, event in log.events:
        fields = {name: value for name, value in event.items() if name != "event"}
        if event.get("event") == MARK:
            marks.append(_parse(Mark, {"time_ns": time_ns, **fields}))
        elif event.get("event") == DRIFT:
            drift = _parse(DriftCheck, fields)
    return replay(marks), drift


def _parse(kind: type[_Kind], fields: dict[str, Any]) -> _Kind:
    try:
        return kind.model_validate(fields)
    except ValueError as error:
        raise DataError(
            "an event of the log is damaged",
            expected=f"a {kind.__name__}",
            found=str(error).splitlines()[0],
            where=Where(channel="/events"),
        ) from None


def _mark_text(mark: Mark) -> str:
    """Return a mark as a few words."""
    where = f"episode {mark.episode}" if mark.episode else "no episode"
    by = f"key {mark.typed}" if mark.typed else mark.by
    return f"{mark.mark} ({by}): {where}"
