"""The recorded supply of the drives, as effects follow it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.scenes import Scene
from candata.schema.episode import Episode

Array = NDArray[np.float64]
CHANNEL = "supply_voltage"


def followed_supply(scene: Scene, episodes: Sequence[Episode], length: int) -> tuple[Array | None, tuple[str, ...]]:
    """Return the supply of the scene's actuators over its median `(E, T, A)`, and notes; None where none is a reading.

    A reading varies within episodes. What is one value in every row of an episode is a label: nothing follows it, and
    its actuators have 1. Rows without a reading hold the last one.

    Parameters
    ----------
    scene : Scene
    episodes : sequence of E Episode
    length : int
        Rows T to which episodes are padded with their last row.

    Raises
    ------
    DataError
        When the columns are not those of the actuators, or a median is no voltage.
    """
    names = scene.file.actuator_names
    if not names or not any(CHANNEL in e for e in episodes):
        return None, ()
    volts = [_volts(scene, e) for e in episodes if CHANNEL in e and e.valid(CHANNEL).any()]
    if lacking := len(episodes) - len(volts):
        return None, (f"no effect follows {CHANNEL}: {lacking} of {len(episodes)} episodes lack it",)
    is_reading = np.any([np.ptp(v, axis=0) > 0 for v in volts], axis=0)
    labels = [name for name, reading in zip(names, is_reading, strict=True) if not reading]
    notes = (
        f"no effect follows {CHANNEL} of {', '.join(labels)}: one value in all rows of an episode is no reading",
    ) * bool(labels)
    if not is_reading.any():
        return None, notes
    usual = np.where(is_reading, np.median(np.concatenate(volts), axis=0), 1.0)
    if (usual <= 0).any():
        name, value = next((n, v) for n, v in zip(names, usual, strict=True) if v <= 0)
        raise DataError(
            f"{CHANNEL} of {name} is no voltage",
            expected="a median above 0 V",
            found=f"{value:g} V",
            where=Where(channel=CHANNEL),
            fix="map the reading in volts, or leave the channel out",
        )
    ratios = [np.where(is_reading, v / usual, 1.0) for v in volts]
    return np.stack([np.concatenate([r, np.repeat(r[-1:], length - len(r), axis=0)]) for r in ratios]), notes


def _volts(scene: Scene, episode: Episode) -> Array:
    """Return readings `(T, A)` [V] in the scene's order; the last one is held, and before the first that one."""
    volts, is_valid = np.array(episode[CHANNEL], float), episode.valid(CHANNEL)
    last = np.maximum.accumulate(np.where(is_valid, np.arange(len(volts)), is_valid.argmax()))
    return volts[last][:, _columns(scene, episode, volts.shape[1])]


def _columns(scene: Scene, episode: Episode, width: int) -> NDArray[np.int64]:
    """Return the recorded column of each of the scene's actuators: by name, else by position; one serves all."""
    wanted, recorded = scene.file.actuator_names, episode.meta.actuator_names
    if width == 1:
        return np.zeros(len(wanted), int)
    if len(recorded) == width and set(wanted) <= set(recorded):
        return np.array([recorded.index(name) for name in wanted])
    if width == len(wanted):
        return np.arange(width)
    raise DataError(
        f"{CHANNEL} does not fit the scene",
        expected=f"one column, or {len(wanted)}: {', '.join(wanted)}",
        found=f"{width} columns",
        where=Where(episode=episode.meta.id, channel=CHANNEL),
        fix="map one column for the common supply, or one for each actuator in the order of the commands",
    )
