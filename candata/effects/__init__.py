"""Effects: one file each; the folder is the registry."""

from candata.effects._contract import Bounds, Effect, Forces, Hook, Parameter
from candata.effects._file import read_effects, scene_of
from candata.effects._lookup import (
    active,
    effect,
    effect_names,
    flatten,
    members_of,
    parameters_on,
    rail_units,
    setting,
    together_on,
    turn,
)

__all__ = [
    "Bounds",
    "Effect",
    "Forces",
    "Hook",
    "Parameter",
    "active",
    "effect",
    "effect_names",
    "flatten",
    "members_of",
    "parameters_on",
    "rail_units",
    "read_effects",
    "scene_of",
    "setting",
    "together_on",
    "turn",
]
