"""Units as pages print them: a joint's unit from its scene when that is built in, else both units that it can have."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from candata.scenes import Scene, load_scene
from candata.scenes.contract import SCENES
from candata.scenes.roles import roles

#: Unit of a joint's position when nothing says whether it turns or slides.
UNKNOWN_JOINT_UNIT = "rad or m"
#: Derivatives and efforts of a joint whose position is in `rad` or `m`.
_EFFORT = {"rad": "N m", "m": "N"}


@cache
def joint_units(scene: str | None) -> Mapping[str, str]:
    """Return joint or actuator name to `rad` or `m`; empty for a scene that is not built in."""
    if scene is None or scene not in SCENES:
        return {}
    return units_in(load_scene(scene))


def units_in(scene: Scene) -> Mapping[str, str]:
    """Return joint or actuator name to `rad` or `m`, as the scene has them."""
    joints = roles(scene).joints
    return {joint.name: joint.unit for joint in joints} | {j.actuator: j.unit for j in joints if j.actuator}


def readable_unit(unit: str, element: str, units: Mapping[str, str]) -> str:
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
    joint_unit = units.get(element)
    if unit == "joint effort":
        return _EFFORT[joint_unit] if joint_unit else "N m or N"
    if unit == "command":
        return joint_unit or UNKNOWN_JOINT_UNIT
    if unit.startswith("joint"):
        suffix = unit.removeprefix("joint")
        return f"{joint_unit}{suffix}" if joint_unit else f"rad{suffix} or m{suffix}"
    return "" if unit == "1" else unit
