"""Goals by name, for chunks whose policy does not say what it means."""

from __future__ import annotations

from candata.errors import UnknownNameError
from candata.policies import Goal

#: What each name asks of the object from a start on. Chosen: `lift` is half of the lowest lift of `grasp_lift_shake`,
#: held as long as fingers need to settle;
#: `turn` is a twelfth of a turn.
GOALS = {
    "lift": Goal(lift_m=0.02, held_s=0.3),
    "turn": Goal(turn_rad=0.5),
    "topple": Goal(topple=True),
}


def goal_named(name: str) -> Goal:
    """Return the goal of a name.

    Raises
    ------
    UnknownNameError
        When there is none of it.
    """
    if name not in GOALS:
        raise UnknownNameError("goal", name, GOALS)
    return GOALS[name]
