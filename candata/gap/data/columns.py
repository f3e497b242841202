"""Recorded channels and commands in the scene's order, by name, else by position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, RateError, Where
from candata.scenes import Scene
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Channels of joints that are compared where every episode holds them.
ALONGSIDE = ("joint_velocity", "joint_effort")
#: Recorded rate may differ this much from the scene's: clocks drift by parts per million, not by per cent.
RATE_TOLERANCE = 0.02


def recorded_columns(scene: Scene, episode: Episode) -> dict[str, NDArray[np.int64]]:
    """Return, for each channel, the recorded columns in the scene's order."""
    meta, file = episode.meta, scene.file
    if abs(meta.rate_hz / file.rate_hz - 1) > RATE_TOLERANCE:
        raise RateError(
            "the episode's rate is not the scene's",
            expected=f"{file.rate_hz:g} Hz",
            found=f"{meta.rate_hz:g} Hz, {meta.rate_hz / file.rate_hz:.4g} times that",
            where=Where(episode=meta.id),
            fix="give map.yaml (or the episode) and scene.yaml the true rate of the recording",
        )
    pairs = {
        **{c: (meta.joint_names, file.joints) for c in ("joint_position", *ALONGSIDE)},
        "action": (meta.actuator_names, file.actuator_names),
        "fingertip_force": (meta.fingertip_names, file.fingertips),
    }
    return {c: _order(episode, c, have, want) for c, (have, want) in pairs.items() if c in episode}


def _order(episode: Episode, channel: str, have: Sequence[str], want: Sequence[str]) -> NDArray[np.int64]:
    """Return the columns of `want` in what the episode has: by name, else by position when the count agrees."""
    width = episode[channel].shape[1]
    if set(want) <= set(have):
        return np.array([list(have).index(name) for name in want], int)
    if width != len(want):
        raise DataError(
            f"{channel} does not fit the scene",
            expected=f"{len(want)} columns: {', '.join(want)}",
            found=f"{width}: {', '.join(have) or 'without names'}",
            where=Where(episode=episode.meta.id, channel=channel),
            fix="list the same joints in scene.yaml and in the map, in the order of the columns",
        )
    return np.arange(width)


def masked(episode: Episode, channel: str) -> Array:
    """Return a channel with NaN where it is not valid."""
    values = np.array(episode[channel], float)
    values[~episode.valid(channel)] = np.nan
    return values


def held_commands(scene: Scene, episode: Episode, columns: dict[str, NDArray[np.int64]]) -> Array:
    """Return `(T, A)` commands held over the step after each row; a gap holds the command before it."""
    width = len(scene.actuator_ids)
    if width == 0:
        return np.zeros((len(episode), 0))
    if "action" not in episode:
        raise DataError(
            "the scene has actuators but the episode has no commands",
            expected="channel action",
            found=", ".join(episode.arrays),
            where=Where(episode=episode.meta.id),
            fix="map the commands to `action`, or list no actuators in scene.yaml",
        )
    values = masked(episode, "action")[:, columns["action"]]
    for row in range(1, len(values)):
        gap = ~np.isfinite(values[row])
        values[row, gap] = values[row - 1, gap]
    if not np.isfinite(values).all():
        raise DataError(
            "the first command is not valid", where=Where(episode=episode.meta.id, channel="action", index=0)
        )
    if episode.meta.action == "previous":
        values = np.concatenate([values[1:], values[-1:]])
    return values


#: Channels that are compared, besides those of joints that are where every episode holds them.
COMPARED = ("joint_position", "object_pose", "fingertip_force")
