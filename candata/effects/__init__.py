"""Effects: one file each; the folder is the registry."""

from candata.effects._contract import Advice, Bounds, DryFriction, Effect, Forces, Hook, Parameter, Trait
from candata.effects._file import read_effects, scene_of
from candata.effects._lookup import (
    EFFECTS,
    active,
    effect,
    effect_names,
    effects_with,
    flatten,
    members_of,
    parameters_on,
    rail_units,
    setting,
    together_on,
    turn,
)

__all__ = [
    "EFFECTS",
    "Advice",
    "Bounds",
    "DryFriction",
    "Effect",
    "Forces",
    "Hook",
    "Parameter",
    "Trait",
    "active",
    "effect",
    "effect_names",
    "effects_with",
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
