"""Sessions: marks in, episodes out; no clock, no file, no terminal.

A mark begins or ends an episode, or judges one. A judgement counts for the episode under way, or for the last one if
none is under way; the last judgement of an episode counts. A mark that fits no episode is kept as it was typed, with
a note, and changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from candata.schema.session import BEGIN, DISCARD, END, Mark, MarkKind, MarkSource, SessionEpisode

#: Key to the mark that it makes; the space bar begins and ends.
SPACE = " "
KEYS: Mapping[str, MarkKind] = {"s": "success", "l": "slip", "d": "drop", "m": "miss", "x": "discard"}
#: Time after a begin or an end in which the space bar answers to none of it yet [s]: by contact or by the schedule it
#: came just before the key that meant the same. Source: simple reactions to what is seen take 0.2 s on average
#: (Woods et al. 2015, Frontiers in Human Neuroscience 9:131).
REACTION_S = 0.2
#: What the keys do, for people.
KEY_WORDS = "space begins/ends · s success · l slip · d drop · m miss · x discard"


class Session:
    """The marks and the episodes so far."""

    def __init__(self) -> None:
        """Begin without marks."""
        self.marks: list[Mark] = []
        self.episodes: list[SessionEpisode] = []

    @property
    def open_episode(self) -> SessionEpisode | None:
        """The episode under way, None if none is."""
        return self.episodes[-1] if self.episodes and self.episodes[-1].end_ns is None else None

    def typed(self, key: str, time_ns: int) -> MarkKind | None:
        """Return the mark that a key makes at a time [ns], None for a key that makes none.

        The space bar that comes within `REACTION_S` of a begin or an end meant that one: it changes nothing more.
        """
        if key != SPACE:
            return KEYS.get(key)
        begins = self.open_episode is None
        newest_ns = (self.episodes[-1].end_ns or self.episodes[-1].begin_ns) if self.episodes else None
        if newest_ns is not None and time_ns - newest_ns < 1e9 * REACTION_S:
            begins = not begins
        return "begin" if begins else "end"

    def mark(self, mark: MarkKind, time_ns: int, by: MarkSource = "key", typed: str = "") -> Mark:
        """Return the mark as it is kept, after it did what it can do."""
        number, note = self._apply(mark, time_ns)
        kept = Mark(time_ns=time_ns, mark=mark, by=by, typed=typed, episode=number, note=note)
        self.marks.append(kept)
        return kept

    def _apply(self, mark: MarkKind, time_ns: int) -> tuple[int | None, str]:
        """Change the episodes; return the number of the one that the mark fits, and a note."""
        is_open = self.open_episode is not None
        if mark == BEGIN:
            if is_open:
                return None, f"episode {len(self.episodes)} is under way: this begin is kept and begins nothing"
            self.episodes.append(SessionEpisode(number=len(self.episodes) + 1, begin_ns=time_ns))
            return len(self.episodes), ""
        if mark == END and not is_open:
            return None, "no episode is under way: this end is kept and ends nothing"
        if not self.episodes:
            return None, f"no episode has begun: this {mark} is kept and judges nothing"
        judged = self.episodes[-1]
        self.episodes[-1] = judged.model_copy(update=_judged(mark, time_ns))
        is_another = judged.outcome is not None and mark not in (END, DISCARD, judged.outcome)
        note = f"episode {judged.number} was {judged.outcome}, now {mark}" if is_another else ""
        return judged.number, note


def replay(marks: Iterable[Mark]) -> Session:
    """Return the session that kept marks lead to, in the order in which they were made.

    Each counts for the episode that it bears, so that marks which are lost, as with a damaged piece of a log, give no
    episode another number. An episode whose begin is lost is missing; one whose end is lost has none.
    """
    episodes: dict[int, SessionEpisode] = {}
    session = Session()
    for mark in marks:
        session.marks.append(mark)
        if mark.episode is None:
            continue
        if mark.mark == BEGIN:
            episodes[mark.episode] = SessionEpisode(number=mark.episode, begin_ns=mark.time_ns)
        elif mark.episode in episodes:
            update = _judged(mark.mark, mark.time_ns)
            episodes[mark.episode] = episodes[mark.episode].model_copy(update=update)
    session.episodes = [episodes[number] for number in sorted(episodes)]
    return session


def _judged(mark: MarkKind, time_ns: int) -> dict[str, Any]:
    """Return what a mark that begins nothing changes of its episode."""
    if mark == END:
        return {"end_ns": time_ns}
    return {"discarded": True} if mark == DISCARD else {"outcome": mark}


@dataclass(frozen=True)
class SessionPlan:
    """What marks a session by itself; without any of it, keys alone do.

    Attributes
    ----------
    episodes : int or None
        How many episodes the session has; it ends after them.
    length_s : float or None
        Length of an episode that begins by the schedule [s].
    gap_s : float
        Rest before each episode by the schedule; or, by contact, how long the hand touches nothing before the
        episode ends [s].
    on_contact : bool
        Whether an episode begins when a fingertip touches something.
    """

    episodes: int | None = None
    length_s: float | None = None
    gap_s: float = 1.0
    on_contact: bool = False

    def is_done(self, session: Session) -> bool:
        """Tell whether all episodes were recorded."""
        return self.episodes is not None and len(session.episodes) >= self.episodes and session.open_episode is None


@dataclass(frozen=True)
class Touch:
    """What the fingertips did so far: when one touched last, when none did last [ns]; null before the first time."""

    touched_ns: int | None = None
    free_ns: int | None = None

    def seen(self, time_ns: int, is_touching: bool) -> Touch:
        """Return it after a reading."""
        return replace(self, touched_ns=time_ns) if is_touching else replace(self, free_ns=time_ns)


def due_mark(
    plan: SessionPlan, session: Session, now_ns: int, start_ns: int, touch: Touch
) -> tuple[MarkKind, int] | None:
    """Return the mark that a plan makes by `now_ns` and its time [ns], None if none is due.

    A scheduled mark has the time at which it was due, so that no delay adds up over a session.

    Parameters
    ----------
    plan : SessionPlan
        What marks the session.
    session : Session
        Marks and episodes so far.
    now_ns, start_ns : int
        Now, and since when episodes may begin [ns].
    touch : Touch
        What the fingertips did up to now.
    """
    open_episode = session.open_episode
    if open_episode is None:
        if plan.episodes is not None and len(session.episodes) >= plan.episodes:
            return None
        last = session.episodes[-1].end_ns if session.episodes else None
        rested_ns = start_ns if last is None else max(start_ns, last)
        if plan.on_contact:
            return ("begin", now_ns) if _touches_after_rest(now_ns, rested_ns, touch) else None
        return _scheduled("begin", rested_ns, plan.gap_s, now_ns) if plan.length_s is not None else None
    if plan.on_contact:
        quiet_ns = now_ns - max(touch.touched_ns or 0, open_episode.begin_ns)
        return ("end", now_ns) if quiet_ns >= 1e9 * plan.gap_s else None
    return _scheduled("end", open_episode.begin_ns, plan.length_s, now_ns) if plan.length_s is not None else None


def _scheduled(mark: MarkKind, since_ns: int, after_s: float, now_ns: int) -> tuple[MarkKind, int] | None:
    """Return a mark that is due some time after a moment, None before that."""
    due_ns = since_ns + round(1e9 * after_s)
    return (mark, due_ns) if now_ns >= due_ns else None


def _touches_after_rest(now_ns: int, rested_ns: int, touch: Touch) -> bool:
    """Tell whether a fingertip touches now, and the fingertips were free since the last episode."""
    free_ns, touched_ns = touch.free_ns, touch.touched_ns
    return free_ns is not None and touched_ns is not None and rested_ns <= free_ns < touched_ns == now_ns
