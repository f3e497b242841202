"""Budget: CPU seconds that a diagnosis may take; once they are spent, it says what it knows by then."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

from candata.errors import UsageError
from candata.gap.replay.replayer import Replayer


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
        """Return a replayer that raises `BudgetSpent` after the simulation that spends the budget."""

        def count(steps: int) -> None:
            replayer.count(steps)
            if self.spent > self.seconds:
                raise BudgetSpent(self)

        return replace(replayer, count=count)


class BudgetSpent(Exception):
    """The CPU seconds of a diagnosis are spent; `candata.gap.verdict.interruption` says what is known by then."""

    def __init__(self, budget: Budget) -> None:
        """Keep the budget."""
        super().__init__(f"{budget.seconds:g} CPU s")
        self.budget = budget
