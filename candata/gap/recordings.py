"""Recordings: episodes of a dataset on the scene's names and clock, padded to one length."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.scenes import Scene
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Channels that are compared, in the order of the residual's columns.
COMPARED = ("joint_position", "object_pose", "fingertip_force")
#: Recorded rate may differ this much from the scene's: clocks drift by parts per million, not by per cent.
RATE_TOLERANCE = 0.02


@dataclass(frozen=True)
class Recordings:
    """E episodes of T rows (the longest; shorter ones are padded with NaN).

    Attributes
    ----------
    ids, tasks : tuple of str
        Episode ids and what was played.
    commands : (E, T, A) float64
        Held over [time_k, time_k+1).
    readings : dict of str to ndarray
        Recorded `joint_position (E, T, J)`, `object_pose (E, T, 7)`, `fingertip_force (E, T, F, 3)`; NaN where not
        valid. Channels that an episode set lacks are not there.
    lengths : (E,) int64
        Rows of each episode.
    instant_force : bool
        Whether the force is the last instant's instead of the step's mean.
    notes : tuple of str
        What was left out, what is doubtful, what cannot be tested: for the report.
    moving : bool
        Whether anything was seen to move.
    """

    ids: tuple[str, ...]
    tasks: tuple[str, ...]
    commands: Array
    readings: dict[str, Array]
    lengths: NDArray[np.int64]
    instant_force: bool
    notes: tuple[str, ...] = ()
    moving: bool = True

    def __len__(self) -> int:
        """Return the number of episodes E."""
        return len(self.ids)

    def take(self, index: Sequence[int] | NDArray[np.int64]) -> Recordings:
        """Return the recordings of some episodes."""
        index = np.asarray(index, int)
        return replace(
            self,
            ids=tuple(self.ids[i] for i in index),
            tasks=tuple(self.tasks[i] for i in index),
            commands=self.commands[index],
            readings={n: v[index] for n, v in self.readings.items()},
            lengths=self.lengths[index],
        )


def recordings(scene: Scene, episodes: Iterable[Episode]) -> Recordings:
    """Return the recordings of `episodes` in the order of the scene's joints and actuators.

    Raises
    ------
    DataError
        When an episode's joints, actuators, fingertips or rate are not the scene's.
    """
    found = list(episodes)
    columns = [_columns(scene, e) for e in found]
    shared = [c for c in COMPARED if _wanted(scene, c) and found and all(c in e for e in found)]
    if not shared:
        raise DataError(
            "nothing to compare",
            expected=f"one of {', '.join(COMPARED)} in every episode",
            found=", ".join(found[0].arrays) if found else "no episodes",
        )
    timings = {e.meta.force for e in found}
    if len(timings) > 1:
        raise DataError(
            "episodes differ in what a force means",
            expected="one of mean, instant",
            found=" and ".join(sorted(timings)),
            fix="import them with the same `force` in map.yaml",
        )
    length = max((len(e) for e in found), default=0)
    if length < 2:
        raise DataError("episodes are too short to replay", expected="at least 2 rows", found=f"{length}")
    readings = {
        c: np.stack(
            [
                _padded(_masked(e, c)[:, cols[c]] if c != "object_pose" else _masked(e, c), length, np.nan)
                for e, cols in zip(found, columns, strict=True)
            ]
        )
        for c in shared
    }
    commands = np.stack(
        [_padded(_commands(scene, e, cols), length, None) for e, cols in zip(found, columns, strict=True)]
    )
    return Recordings(
        tuple(e.meta.id for e in found),
        tuple(e.meta.task or "" for e in found),
        commands,
        readings,
        np.array([len(e) for e in found]),
        found[0].meta.force == "instant",
    )


def _wanted(scene: Scene, channel: str) -> bool:
    """Tell whether the scene can predict a channel."""
    return {
        "joint_position": len(scene.joint_ids) > 0,
        "object_pose": scene.object_id is not None,
        "fingertip_force": len(scene.force_sensors) > 0,
    }[channel]


def _columns(scene: Scene, episode: Episode) -> dict[str, NDArray[np.int64]]:
    """Return, for each channel, the recorded columns in the scene's order."""
    meta, file = episode.meta, scene.file
    if abs(meta.rate_hz / file.rate_hz - 1) > RATE_TOLERANCE:
        raise DataError(
            "the episode's rate is not the scene's",
            expected=f"{file.rate_hz:g} Hz",
            found=f"{meta.rate_hz:g} Hz",
            where=Where(episode=meta.id),
            fix="give map.yaml (or the episode) and scene.yaml the true rate of the recording",
        )
    pairs = {
        "joint_position": (meta.joint_names, file.joints),
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


def _masked(episode: Episode, channel: str) -> Array:
    """Return a channel with NaN where it is not valid."""
    values = np.array(episode[channel], float)
    values[~episode.valid(channel)] = np.nan
    return values


def _commands(scene: Scene, episode: Episode, columns: dict[str, NDArray[np.int64]]) -> Array:
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
    values = _masked(episode, "action")[:, columns["action"]]
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


def _padded(values: Array, length: int, fill: float | None) -> Array:
    """Return values with rows appended up to `length`: of `fill`, or of the last row."""
    missing = length - len(values)
    tail = np.repeat(values[-1:], missing, axis=0) if fill is None else np.full((missing, *values.shape[1:]), fill)
    return np.concatenate([values, tail])
