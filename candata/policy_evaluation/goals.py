"""Goals by name, for policies and chunks that do not say what they mean."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from candata.errors import UnknownNameError, UsageError
from candata.policies import Goal

#: What each name asks of the object from a start on. Chosen: `lift` is half of the lowest lift of `grasp_lift_shake`,
#: held as long as fingers need to settle; `turn` is a twelfth of a turn.
GOALS = {
    "lift": Goal(lift_m=0.02, held_s=0.3),
    "turn": Goal(turn_rad=0.5),
    "topple": Goal(topple=True),
}
#: Longest way that a goal may ask for [m], and largest turn [rad]. Chosen: a hand at a table moves nothing farther, so
#: larger numbers are millimetres or degrees. A turn is told up to half a turn.
MOST_WAY_M, MOST_TURN_RAD = 2.0, np.pi
#: How goals are written.
WORDS = "lift[:m[,s]], place:x,y (m), turn[:rad] or topple"


def parsed_goal(text: str) -> Goal:
    """Return the goal that a text means: `lift`, `lift:0.05,1`, `place:0.1,0`, `turn:0.5` or `topple`.

    Raises
    ------
    UnknownNameError
        When there is no such goal.
    UsageError
        When its numbers do not fit, or are so large that they are in other units.
    """
    name, _, rest = (part.strip() for part in text.partition(":"))
    if name not in GOALS and name != "place":
        raise UnknownNameError("goal", name, (*GOALS, "place"))
    try:
        numbers = [float(word) for word in rest.split(",") if word.strip()]
    except ValueError:
        numbers = [float("nan")]
    goal = _with_numbers(name, numbers) if np.isfinite(numbers).all() else None
    if goal is None:
        raise UsageError("--goal cannot be read", expected=WORDS, found=repr(text))
    ways_m = [goal.lift_m] if goal.place_m is None else np.abs(goal.place_m).tolist()
    if max(ways_m) > MOST_WAY_M or goal.turn_rad > MOST_TURN_RAD:
        raise UsageError(
            "--goal asks for more than can be reached",
            expected=f"metres up to {MOST_WAY_M:g}, radians up to {MOST_TURN_RAD:.3g}",
            found=repr(text),
        )
    return goal


def check_held(goal: Goal | None, duration_s: float) -> None:
    """Refuse a length that is no number, and a lift that must be held for longer than what is played.

    Raises
    ------
    UsageError
        When it is so.
    """
    if not np.isfinite(duration_s):
        raise UsageError("what is played has no length", expected="seconds", found=f"{duration_s:g}")
    if goal is not None and goal.lift_m > 0 and goal.held_s > duration_s:
        raise UsageError(
            "the goal asks to hold for longer than what is played",
            expected=f"at most {duration_s:g} s",
            found=f"{goal.held_s:g} s",
            fix="play for longer, or give --goal lift:m,s with a shorter time",
        )


def _with_numbers(name: str, numbers: list[float]) -> Goal | None:
    """Return a goal with the numbers that are given; None where they do not fit."""
    if name == "place":
        return Goal(place_m=np.array([*numbers, 0.0])) if len(numbers) == 2 else None
    fields = {"lift": ("lift_m", "held_s"), "turn": ("turn_rad",)}.get(name, ())
    if len(numbers) > len(fields) or any(number <= 0 for number in numbers):
        return None
    changes: dict[str, Any] = dict(zip(fields, numbers, strict=False))
    return replace(GOALS[name], **changes)
