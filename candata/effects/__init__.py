"""Effects: one file each; the folder is the registry."""

from candata.effects._contract import Advice, Bounds, DryFriction, Effect, Forces, Hook, Parameter, Servos, Trait
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
    sensed_at,
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
    "Servos",
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
    "sensed_at",
    "setting",
    "together_on",
    "turn",
]
