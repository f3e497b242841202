"""Budget: CPU seconds that a diagnosis may take; where they are too few it stops without a verdict."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

from candata.errors import UsageError
from candata.gap.replay import Replayer

#: Replays of all episodes that a diagnosis takes at least, when the signatures of all effects are kept already: nulls
#: for the floor, starts, the best candidates, the floor of the repaired world.
LEAST_REPLAYS = 30


@dataclass(frozen=True)
class Budget:
    """CPU seconds of all threads from `began` on: they do not depend on `jobs`, or on what else the machine does.

    Attributes
    ----------
    seconds : float
    began : float
        Process time at the start.
    """

    seconds: float
    began: float = field(default_factory=time.process_time)

    def __post_init__(self) -> None:
        """Refuse a budget that is no time at all."""
        if not self.seconds > 0:
            raise UsageError("--budget must be above zero", expected="CPU seconds", found=f"{self.seconds:g}")

    @property
    def spent(self) -> float:
        """CPU seconds so far."""
        return time.process_time() - self.began

    def watched(self, replayer: Replayer) -> Replayer:
        """Return a replayer that stops once the budget is spent: every simulation counts itself with it."""

        def count(steps: int) -> None:
            replayer.count(steps)
            if self.spent > self.seconds:
                raise _too_small("the budget is spent and nothing is decided yet", f"{self.seconds:g} CPU s", None)

        return replace(replayer, count=count)

    def check(self, replay_s: float, episodes: int) -> None:
        """Refuse at once what cannot be done.

        Parameters
        ----------
        replay_s : float
            CPU seconds that one replay of all episodes took.
        episodes : int

        Raises
        ------
        UsageError
            When even a diagnosis whose signatures are kept takes more than what is left.
        """
        need = self.spent + LEAST_REPLAYS * replay_s
        if need > self.seconds:
            why = f"{episodes} episodes, {replay_s:.2g} s for each of {LEAST_REPLAYS} replays"
            raise _too_small("the budget is too small for a diagnosis", f"{self.seconds:g} CPU s", (need, why))


def _too_small(problem: str, found: str, need: tuple[float, str] | None) -> UsageError:
    """Return the refusal: no verdict is better than one of a search that was cut short."""
    return UsageError(
        problem,
        expected=f"about {need[0]:.0f} CPU s or more ({need[1]}), several times that for commands not diagnosed before"
        if need
        else "a search of all effects that can act",
        found=found,
        fix="raise --budget (with --cache what was simulated is kept for the next run), take fewer episodes "
        "(`candata registry filter`), or name the effects to search (--only)",
    )
