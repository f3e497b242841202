"""The part of each effect that MJCF can hold, and where the rest belongs."""

from __future__ import annotations

from collections.abc import Sequence

from candata.effects import effect
from candata.schema.effect import EffectSetting, Value
from candata.schema.record import ResultRecord

_COMMAND = "commands: pass them through this in the code that sends them to the simulator"
_READING = "readings: pass them through this in the code that reads the simulator's state"
_FORCE = "forces: add them to qfrc_applied before each control step"
_SERVO = "servos: compute their command from the joint positions before each physics step"
_FRICTION = "friction: set dof_frictionloss through this before each control step"
_DRIVE = "drives: scale gainprm, biasprm and forcerange of the servos through this before each control step"
_PACE = "clock: stamp the recording with its true rate, or step this much more or less time between two rows"
_AS_CANDATA = "run the effects.yaml beside this with candata"


class HeldEffect(ResultRecord):
    """An effect that the exported model holds."""

    name: str
    element: str | None = None
    parameters: dict[str, Value]

    @property
    def label(self) -> str:
        """Name and element in words."""
        return f"{self.name} on {self.element}" if self.element else self.name


class OmittedEffect(HeldEffect):
    """An effect, or its part, that the exported model does not hold: why, and where to apply it instead."""

    whole: bool
    why: str
    apply: str


def holds(s: EffectSetting) -> bool:
    """Tell whether MJCF can hold the effect, or what of it acts in the model."""
    kind = effect(s.name)
    return (kind.edit is not None or kind.native is not None) and kind.pace is None


def omitted_effect(s: EffectSetting, reason: str | None = None) -> OmittedEffect | None:
    """Return the part of an effect that stays outside the model; None where nothing does.

    Parameters
    ----------
    s : EffectSetting
    reason : str, optional
        Why an effect that acts in the model could not be written.
    """
    kind = effect(s.name)
    hooks = [("command", _COMMAND), ("reading", _READING), ("force", _FORCE)]
    hooks += [("friction", _FRICTION), ("drive", _DRIVE), ("servo", _SERVO), ("pace", _PACE)]
    places = [text for name, text in hooks if getattr(kind, name) is not None]
    if kind.native is not None and reason is None:
        return None
    is_whole = reason is not None or not holds(s)
    if not is_whole and not places:
        return None
    if reason is None:
        reason = f"MJCF has no attribute for it: {kind.about}"
    if not is_whole:
        reason = f"the model holds what acts in it; the rest is no part of MJCF: {kind.about}"
    apply = "; ".join(places) if places else "set it in code after loading the model"
    candata_hint = f"; or {_AS_CANDATA}" if is_whole else ""
    return OmittedEffect(
        name=s.name, element=s.element, parameters=s.parameters, whole=is_whole, why=reason, apply=apply + candata_hint
    )


def effects_to_add(omitted_effects: Sequence[OmittedEffect]) -> tuple[EffectSetting, ...]:
    """Return the effects that candata still has to add to the exported model."""
    return tuple(
        EffectSetting(name=e.name, element=e.element, parameters=e.parameters) for e in omitted_effects if e.whole
    )
