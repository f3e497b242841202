"""Pace: how long what is left of a diagnosis takes, told in ranges that other diagnoses took, and as its latest end."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple


class Span(NamedTuple):
    """Least and most replays of all episodes that a step took."""

    least: float
    most: float


#: The whole search for one cause, what each further one adds, comparing the best of a look, and what comes after the
#: search: measured with signatures kept on ten drawn cases of the built-in hand (20 episodes, a replay of all took 1.0
#: CPU s), `ANOTHER` beside the whole time of eight more; the least of what one cause takes on four later ones.
ONE, ANOTHER, SHARPEN, REST = Span(12, 36), Span(30, 65), Span(6, 20), Span(1, 12)
#: Looking at every effect by simulation, and with it a whole second search: two recordings of another engine.
AGAIN = Span(40, 270)
#: Counting the episodes that one value explains, of one scalar or two, and the floors of two worlds: by their numbers.
COUNT = Span(10, 55)
#: Trying one force in the place of effects: two cases of a gripper, 32 replays and as much time again of fitting.
FORCE = Span(0, 80)
#: Replays that one signature takes, of its episodes: a recording in the changed world, and its nominal replay.
SIGNATURE = 2.0
#: Seconds of fitting in any step, and how much time left is worth a word.
FITTING_S, WORTH_S = 5.0, 10.0
#: Seconds from which on minutes are told.
MINUTES_S = 120.0


class Forecast:
    """The latest end of a diagnosis, from what is planned of it and how fast it goes.

    What is planned is an upper end of what each step took elsewhere, in replays of all episodes, so that the latest end
    comes nearer as steps take less or are not needed. It moves later only where more is to be done than was planned.

    Attributes
    ----------
    ends_s : float or None
        Latest end, on the clock's time [s]; None where nothing is planned.
    """

    def __init__(
        self, told: Callable[[float], None] = lambda ends_s: None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin without a plan; `told` hears of each better end."""
        self.ends_s: float | None = None
        self._told, self._clock = told, clock
        self._begun_s, self._done, self._planned, self._replay = clock(), 0.0, 0.0, 0.0

    @property
    def done(self) -> float:
        """Replays done since it began to count."""
        return self._done / self._replay if self._replay else 0.0

    @property
    def left(self) -> float:
        """Replays that are planned and not done."""
        return max(self._planned - self._done, 0.0) / self._replay if self._replay else 0.0

    def begin(self) -> None:
        """Count from now on: the next thing simulated is one replay of all episodes."""
        self._begun_s, self._done, self._replay = self._clock(), 0.0, 0.0

    def count(self, steps: int) -> None:
        """Hear of physics steps that were simulated."""
        self._done += steps
        self._replay = self._replay or self._done
        if self.ends_s is not None:
            self._move(may_grow=False)

    def plan(self, replays: float, whole: bool) -> bool:
        """Return whether the end moves later, as at most so many replays are left: all that is planned, or some of it.

        Parameters
        ----------
        replays : float
            The most that what is planned takes from now on.
        whole : bool
            Whether nothing else is planned beside.
        """
        before, more = self.ends_s, replays > self.left
        if not self._replay:
            return False
        if whole or more:
            self._planned = self._done + replays * self._replay
        self._move(may_grow=more)
        return before is not None and self.ends_s is not None and self.ends_s > before

    def _move(self, may_grow: bool) -> None:
        """Put the end where the plan leads at the mean pace so far; not later, unless it may."""
        now = self._clock()
        ends_s = now + max(self._planned - self._done, 0.0) * (now - self._begun_s) / self._done
        if self.ends_s is None or may_grow or ends_s < self.ends_s:
            self.ends_s = ends_s
            self._told(ends_s)


@dataclass(frozen=True)
class Pace:
    """Says what a diagnosis does and how long that takes.

    Attributes
    ----------
    told : callable
        Called with the name of each step.
    replay_s : float
        Seconds that one replay of all episodes took; 0 says nothing of time.
    forecast : Forecast
        Hears how much each step takes at most.
    """

    told: Callable[[str], None] = lambda text: None
    replay_s: float = 0.0
    forecast: Forecast = field(default_factory=Forecast)

    def say(self, step: str, span: Span, more: str = "", after: float | None = None) -> None:
        """Tell of a step that takes as many replays, `more` after its time.

        At most `after` replays are planned after it; None says that it is one of several that were planned together.
        """
        whole = after is not None
        grows = self.forecast.plan(span.most + (after if after is not None else REST.most), whole)
        text = f"{step} ({self.range_of(span)}{more})" if self.range_of(span) else step
        self.told(f"{text}, more than was planned" if grows else text)

    def range_of(self, span: Span) -> str:
        """Return a range of time in words; empty where it is unknown or not worth a word."""
        low, high = span.least * self.replay_s, span.most * self.replay_s + FITTING_S
        if self.replay_s == 0 or high < WORTH_S:
            return ""
        if span.least == 0:
            return f"at most about {_time(high)}"
        if low >= MINUTES_S:
            return f"about {low / 60:.0f} to {_time(high)}"
        return f"about {low:.0f} to {_time(high)}" if high < MINUTES_S else f"about {_time(low)} to {_time(high)}"


def _time(seconds: float) -> str:
    """Return a time in words: seconds up to two minutes, then minutes."""
    return f"{seconds:.0f} s" if seconds < MINUTES_S else f"{seconds / 60:.0f} min"
