"""Units as pages print them: a joint's from its scene where that is built in, else both that it can be."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from candata.scenes import load_scene
from candata.scenes.contract import SCENES
from candata.scenes.roles import roles

#: Word for a joint's position where nobody says whether it turns or slides.
EITHER = "rad or m"
#: Derivatives and efforts of a joint whose position is in `rad` or `m`.
_EFFORT = {"rad": "N m", "m": "N"}


@cache
def joint_units(scene: str | None) -> Mapping[str, str]:
    """Return joint or actuator name to `rad` or `m`; empty for a scene that is not built in."""
    if scene is None or scene not in SCENES:
        return {}
    found = roles(load_scene(scene)).joints
    return {joint.name: joint.unit for joint in found} | {j.actuator: j.unit for j in found if j.actuator}


def readable(unit: str, element: str, units: Mapping[str, str]) -> str:
    """Return a unit in which `joint` and `command` are replaced by what the element's joint takes.

    Parameters
    ----------
    unit : str
        As `candata.datasets.elements` has it.
    element : str
        Name of the joint or actuator.
    units : mapping of str to str
        Of `joint_units`.
    """
    known = units.get(element)
    if unit == "joint effort":
        return _EFFORT[known] if known else "N m or N"
    if unit == "command":
        return known or EITHER
    if unit.startswith("joint"):
        rest = unit.removeprefix("joint")
        return f"{known}{rest}" if known else f"rad{rest} or m{rest}"
    return "" if unit == "1" else unit
