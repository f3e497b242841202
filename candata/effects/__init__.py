"""Effects: one file each; the folder is the registry."""

from candata.effects._contract import Bounds, Effect, Hook, Parameter
from candata.effects._file import read_effects, scene_of
from candata.effects._lookup import active, effect, effect_names, flatten, setting

__all__ = [
    "Bounds", "Effect", "Hook", "Parameter", "active", "effect", "effect_names", "flatten", "read_effects", "scene_of",
    "setting",
]  # fmt: skip
