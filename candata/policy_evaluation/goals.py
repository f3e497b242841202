"""Goals in words: what `--goal` means with the object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from candata.errors import UsageError
from candata.policies import Goal

#: Height to lift [m], time to hold [s] and angle to turn [rad] where a goal does not say. Chosen: half of what
#: `grasp_lift_shake` lifts at the least, and what `turn_in_hand` turns.
LIFT_M, HELD_S, TURN_RAD = 0.02, 0.5, 0.2
WORDS = "lift[:m[,s]], place:x,y (m), turn[:rad], or topple"


def parsed_goal(text: str) -> Goal:
    """Return the goal that a text means: `lift`, `lift:0.05,1`, `place:0.1,0`, `turn:0.5` or `topple`.

    Raises
    ------
    UsageError
        When it means none.
    """
    name, _, rest = text.partition(":")
    try:
        numbers = [float(word) for word in rest.split(",") if word.strip()]
    except ValueError:
        raise _unread(text) from None
    if not np.isfinite(numbers).all():
        raise _unread(text)
    goal = _goal(name.strip(), numbers)
    if goal is None:
        raise _unread(text)
    return goal


def _goal(name: str, numbers: Sequence[float]) -> Goal | None:
    """Return a goal by its name and numbers; None where they do not fit."""
    count, is_positive = len(numbers), all(number > 0 for number in numbers)
    if name == "lift" and count <= 2 and is_positive:
        return Goal(lift_m=numbers[0] if count else LIFT_M, held_s=numbers[1] if count == 2 else HELD_S)
    if name == "place" and count == 2:
        return Goal(place_m=np.array([*numbers, 0.0]))
    if name == "turn" and count <= 1 and is_positive:
        return Goal(turn_rad=numbers[0] if count else TURN_RAD)
    if name == "topple" and not count:
        return Goal(topple=True)
    return None


def _unread(text: str) -> UsageError:
    """Return the error for a text that means no goal."""
    return UsageError("--goal cannot be read", expected=WORDS, found=repr(text))
