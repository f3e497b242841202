"""Records of effects: a setting in a simulation, and the repaired simulator as a file."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from candata.schema.record import Record

Value = float | str | tuple[float, ...]


class EffectSetting(Record):
    """One effect with its values: `element` null means all elements it can act on.

    Numbers may be anything: what is possible in a scene is said by who knows the scene.
    """

    model_config = ConfigDict(allow_inf_nan=True)

    name: str
    element: str | None = None
    parameters: dict[str, Value] = Field(default_factory=dict)


class EffectsFile(Record):
    """`effects.yaml`: a scene and the effects added to it."""

    scene: str | None = None
    effects: tuple[EffectSetting, ...] = ()
