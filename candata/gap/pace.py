"""Pace: about how long what is left of a diagnosis takes, told in ranges that other diagnoses took."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple


class Span(NamedTuple):
    """Least and most replays of all episodes that a step took."""

    least: float
    most: float


#: The whole search for one cause, what each further one adds, comparing the best of a look, and what comes after the
#: search: measured with signatures kept on ten drawn cases of the built-in hand (20 episodes, a replay of all took 1.0
#: CPU s), `ANOTHER` beside the whole time of eight more; the least of what one cause takes on four later ones. A joint
#: fit of everything was seen once, so that its most is all there is to say.
ONE, ANOTHER, SHARPEN, REST = Span(12, 36), Span(30, 65), Span(6, 20), Span(1, 12)
JOINT = Span(0, 250)
#: Looking at every effect by simulation, and with it a whole second search: two recordings of another engine.
AGAIN = Span(40, 270)
#: Looking at every effect by simulation beside what was found: four cases of two hands.
BESIDE = Span(20, 60)
#: Trying sets of effects whose signatures add up: eight cases of two hands.
TOGETHER = Span(6, 50)
#: Counting the episodes that one value explains, of one scalar or two, and the floors of two worlds: by their numbers.
COUNT = Span(10, 55)
#: Looking for a faint effect in the mean over many replays, or for where it acts: 13 drawn cases of a gripper.
MEAN = Span(12, 190)
#: Replays that one signature takes, of its episodes: a recording in the changed world, and its nominal replay.
SIGNATURE = 2.0
#: Seconds of fitting in any step, and how much time left is worth a word.
FITTING_S, WORTH_S = 5.0, 10.0
#: Seconds from which on minutes are told.
MINUTES_S = 120.0


@dataclass(frozen=True)
class Pace:
    """Says what a diagnosis does and how long that takes.

    Attributes
    ----------
    told : callable
        Called with the name of each step.
    replay_s : float
        Seconds that one replay of all episodes took; 0 says nothing of time.
    """

    told: Callable[[str], None] = lambda text: None
    replay_s: float = 0.0

    def say(self, step: str, span: Span, more: str = "") -> None:
        """Tell of a step that takes as many replays, `more` after its time."""
        self.told(f"{step} ({self.range_of(span)}{more})" if self.range_of(span) else step)

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
