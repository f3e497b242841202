"""The channels of a LeRobot set's features, by their names alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from candata.errors import UsageError, Where
from candata.formats._features import Feature
from candata.schema.channels import CHANNELS, DENSE_CHANNELS
from candata.schema.exchange import FeatureMap

STATE, ACTION, PREFIX = "observation.state", "action", "observation."
#: Features of older sets that speak of joints.
_OLDER_FEATURES = {"joint_velocity": "observation.velocity", "joint_effort": "observation.effort"}
#: Last words of a column of `observation.state`, by the channel it belongs to.
_ENDINGS = {".pos": "joint_position", ".vel": "joint_velocity", ".effort": "joint_effort", ".torque": "joint_effort"}


def guess(features: Sequence[Feature], path: Path) -> FeatureMap:
    """Return the map that the features' names imply.

    A feature `observation.<channel>` of fitting size is that channel. `observation.state` is the joints' position
    where its columns bear the action's names (or the same number of columns has no names); columns that end in
    `.pos`, `.vel`, `.effort` are sorted by that.

    Raises
    ------
    UsageError
        When the names do not tell what the state is; says to give a map.
    """
    by_name = {feature.name: feature for feature in features}
    channels: dict[str, str | tuple[str, ...]] = {}
    for channel in CHANNELS:
        feature = by_name.get(PREFIX + channel)
        if channel not in DENSE_CHANNELS and feature is not None and _fitting(channel, feature.width):
            channels[channel] = feature.name
    if ACTION in by_name:
        channels[ACTION] = ACTION
    if "joint_position" not in channels and STATE in by_name and not _packs_poses(by_name[STATE], channels):
        channels |= _state(by_name, path)
    for channel, name in _OLDER_FEATURES.items():
        if name in by_name and "joint_position" in channels and by_name[name].width == by_name[STATE].width:
            channels.setdefault(channel, name)
    if not {"object_pose", "joint_position"} & set(channels):
        raise _unclear("no feature is known as the joints' position or the object's pose", ", ".join(by_name), path)
    return FeatureMap(channels=channels)


def _state(by_name: Mapping[str, Feature], path: Path) -> dict[str, tuple[str, ...] | str]:
    """Return what `observation.state` is made of."""
    state, action = by_name[STATE], by_name.get(ACTION)
    kinds = [next((kind for end, kind in _ENDINGS.items() if name.endswith(end)), "") for name in state.names]
    if "joint_position" in kinds and all(kinds):
        return {
            kind: tuple(f"{STATE}[{k}]" for k, column_kind in enumerate(kinds) if column_kind == kind)
            for kind in dict.fromkeys(kinds)
        }
    if action is not None and action.width == state.width and action.names == state.names:
        return {"joint_position": STATE}
    columns_text = f"{STATE}: {_columns_text(state)}; {ACTION}: {_columns_text(action) if action else 'none'}"
    raise _unclear(f"what {STATE} holds is not clear: it does not look like {ACTION}", columns_text, path)


def _packs_poses(state: Feature, channels: Mapping[str, object]) -> bool:
    """Tell whether the state of a set without joints repeats the object's pose."""
    return "object_pose" in channels and bool(state.names) and all(n.startswith("object.") for n in state.names)


def _fitting(channel: str, width: int) -> bool:
    """Tell whether a row of `width` numbers can be the channel's."""
    symbols = CHANNELS[channel].shape[1:]
    if not symbols:
        return width == 1
    row_width = symbols[-1]
    return not isinstance(row_width, int) or (width == row_width if len(symbols) == 1 else width % row_width == 0)


def _columns_text(feature: Feature) -> str:
    """Return a feature's columns for people."""
    names = f" ({', '.join(feature.names[:4])}{', ...' if len(feature.names) > 4 else ''})" if feature.names else ""
    return f"{feature.width} columns{names}"


def _unclear(problem: str, found: str, path: Path) -> UsageError:
    """Return the error of a set that needs a map."""
    return UsageError(
        problem,
        expected=f"a feature {PREFIX}<channel>, or {STATE} with the columns of {ACTION}",
        found=found,
        where=Where(path=str(path)),
        fix=f"say what is what with --map FILE, such as `channels: {{joint_position: '{STATE}[0:7]', action: action}}`",
    )
