"""What recordings cannot show: effects that need a channel which was not recorded."""

from __future__ import annotations

from candata.effects import effect, effect_names
from candata.errors import UnknownNameError, UsageError
from candata.gap.data.recordings import Recordings
from candata.gap.data.supply import CHANNEL
from candata.scenes import Scene


def untested(scene: Scene, recs: Recordings) -> dict[str, tuple[str, ...]]:
    """Return, for each missing channel, the effects of the library that nothing recorded can show.

    Sensing effects show only in the channels they move; effects on object and fingertips only in poses or forces.
    """
    out: dict[str, list[str]] = {}
    for name in effect_names():
        kind = effect(name)
        if not kind.possible(scene):
            continue
        shows = set(kind.moves) or _shows(kind.acts_on)
        if not shows & set(recs.readings):
            out.setdefault(" or ".join(sorted(shows)), []).append(name)
    return {channel: tuple(names) for channel, names in out.items()}


def _shows(acts_on: str) -> set[str]:
    """Return the channels in which a physical effect shows."""
    if acts_on in ("object", "fingertip"):
        return {"object_pose", "fingertip_force"}
    return {"joint_position", "object_pose", "fingertip_force"}


def untested_notes(scene: Scene, recs: Recordings) -> tuple[str, ...]:
    """Return one sentence for each missing channel: what could not be tested."""
    return tuple(
        f"no {channel}: {', '.join(names)} could not be tested" for channel, names in untested(scene, recs).items()
    )


def library(scene: Scene, recs: Recordings, only: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the names of the effects to search: all that can act and show here, or those asked for.

    Raises
    ------
    UnknownNameError
        When there is no such effect.
    UsageError
        When an effect that was asked for cannot act in the scene, or cannot show in what was recorded.
    """
    hidden = {name: channel for channel, names in untested(scene, recs).items() for name in names}
    every = effect_names((CHANNEL,))
    hidden |= {name: f"{CHANNEL} that varies" for name in set(every) - set(effect_names(recs.channels))}
    possible = [n for n in every if effect(n).possible(scene)]
    for name in only:
        if name not in every:
            raise UnknownNameError("effect", name, every)
        if name not in possible:
            raise UsageError(
                f"effect {name} cannot act in scene {scene.name}",
                expected=f"one of {', '.join(n for n in possible if n not in hidden)}",
                found=name,
                fix=f"it acts on {effect(name).acts_on}: leave it out, or add to the scene what it needs",
            )
        if name in hidden:
            raise UsageError(
                f"effect {name} cannot show in these recordings",
                expected=f"channel {hidden[name]}",
                found=", ".join(recs.channels),
                fix="leave it out, or record the channel",
            )
    return tuple(n for n in only or possible if n not in hidden)
