"""Recordings: episodes of a dataset on the scene's names and clock, padded to one length."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.datasets.cutting import piece
from candata.errors import DataError
from candata.gap.data.columns import COMPARED, held_commands, masked, recorded_columns
from candata.gap.data.deviation import SlowDeviation, shifted_readings
from candata.gap.data.faults import whole_episodes, without_jumps
from candata.gap.data.sample_hold import sources
from candata.gap.data.supply import CHANNEL, followed_supply
from candata.gap.data.velocity import with_aligned_velocity
from candata.scenes import Scene
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Length of the blocks over which residuals are averaged [s].
BLOCK_S = 0.05
#: Episodes that are read of a dataset, drawn at random where it holds more: memory and time then grow no further, and
#: a share that is measured on some 450 episodes is known to about a per cent.
READ = 512


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
        Recorded `joint_position (E, T, J)`, `object_pose (E, T, 7)`, `fingertip_force (E, T, F, 3)`,
        `joint_velocity` and `joint_effort (E, T, J)`; NaN where not valid. Channels that an episode set lacks are not
        there.
    lengths : (E,) int64
        Rows of each episode.
    instant_force : bool
        Whether the force is the last instant's instead of the step's mean.
    notes : tuple of str
        What was left out, what is doubtful, what cannot be tested: for the report.
    moving : bool
        Whether anything was seen to move.
    sources : dict of str to ndarray
        For a channel slower than the log, the row `(E, T)` in which each reading was new; others are not there.
    slow : tuple of SlowDeviation
        What repeats of a motion differ by beyond sensor noise, and what is not known of a reference's misfit; none
        where neither is known, or nothing.
    misfit : (E, T, D) float64 or None
        What the simulator left open in a reference, by the columns of a residual; None without a reference.
    noise_factor : float
        By how much the noise of `compared` is larger than that of one recording: the misfit holds noise too.
    rate_hz : float
        Rows a second; 0 where no velocity or effort needs it.
    unscaled_effort : bool
        Whether the size of `joint_effort` tells nothing, as its unit is not known.
    supply : (E, T, A) float64 or None
        Recorded supply of the actuators over its median; None where no reading of it was recorded.
    """

    ids: tuple[str, ...]
    tasks: tuple[str, ...]
    commands: Array
    readings: dict[str, Array]
    lengths: NDArray[np.int64]
    instant_force: bool
    notes: tuple[str, ...] = ()
    moving: bool = True
    sources: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    slow: tuple[SlowDeviation, ...] = ()
    misfit: Array | None = None
    noise_factor: float = 1.0
    rate_hz: float = 0.0
    unscaled_effort: bool = False
    supply: Array | None = None

    def __len__(self) -> int:
        """Return the number of episodes E."""
        return len(self.ids)

    @cached_property
    def compared(self) -> dict[str, Array]:
        """Readings that are compared with a replay: those recorded, less the misfit of a reference."""
        return self.readings if self.misfit is None else shifted_readings(self.readings, -self.misfit)

    @property
    def channels(self) -> tuple[str, ...]:
        """What was recorded for effects to show in or to follow."""
        return (*self.readings, *([] if self.supply is None else [CHANNEL]))

    @property
    def independent(self) -> NDArray[np.int64]:
        """Number `(E,)` of the independent piece of evidence that each episode belongs to.

        Episodes whose error is shared count as one piece.
        """
        return next((part.piece for part in self.slow if part.is_shared), np.arange(len(self)))

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
            sources={n: rows[index] for n, rows in self.sources.items()},
            slow=tuple(part.take(index) for part in self.slow),
            misfit=None if self.misfit is None else self.misfit[index],
            supply=None if self.supply is None else self.supply[index],
        )


def block_rows(rate_hz: float) -> int:
    """Return the rows of a block."""
    return max(1, round(BLOCK_S * rate_hz))


def read(scene: Scene, dataset: Dataset) -> Recordings:
    """Return the recordings of a dataset, as `recordings` does; of `READ` of its episodes where it holds more."""
    if len(dataset) <= READ:
        return recordings(scene, dataset.episodes())
    drawn = np.sort(np.random.default_rng(0).choice(len(dataset), READ, replace=False))
    found = recordings(scene, dataset.episodes(dataset.ids[i] for i in drawn))
    return replace(found, notes=(f"{READ} of {len(dataset)} episodes looked at, drawn at random", *found.notes))


def recordings(scene: Scene, episodes: Iterable[Episode]) -> Recordings:
    """Return the recordings of `episodes` in the order of the scene's joints and actuators.

    Episodes that cannot be replayed are left out, with a note that names them; so are those that lack a channel which
    most have.

    Raises
    ------
    DataError
        When no episode fits the scene: of the first, what does not fit. When they were played with several objects.
    """
    driven, off_notes = _while_driven(list(episodes))
    found, shared, notes = whole_episodes(scene, driven)
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
    _refuse_several_objects(found)
    columns = [recorded_columns(scene, e) for e in found]
    length = max(len(e) for e in found)
    readings = {
        c: np.stack(
            [
                _padded(masked(e, c)[:, cols[c]] if c != "object_pose" else masked(e, c), length, np.nan)
                for e, cols in zip(found, columns, strict=True)
            ]
        )
        for c in shared
    }
    slow, slower = sources({c: v for c, v in readings.items() if c in COMPARED}, scene.file.rate_hz)
    readings, spiky = without_jumps(readings, scene.file.joints)
    readings, late = with_aligned_velocity(readings, scene.file.rate_hz, scene.file.joints)
    commands = np.stack(
        [_padded(held_commands(scene, e, cols), length, None) for e, cols in zip(found, columns, strict=True)]
    )
    supply, supply_notes = followed_supply(scene, found, length)
    return Recordings(
        tuple(e.meta.id for e in found),
        tuple(e.meta.task or "" for e in found),
        commands,
        readings,
        np.array([len(e) for e in found]),
        found[0].meta.force == "instant",
        (*off_notes, *notes, *slower, *late, *spiky, *supply_notes),
        sources=slow,
        rate_hz=scene.file.rate_hz,
        unscaled_effort=any("joint_effort" in e.meta.unscaled for e in found),
        supply=supply,
    )


def _refuse_several_objects(episodes: Sequence[Episode]) -> None:
    """Refuse episodes that say they were played in scenes with different objects: one scene replays them."""
    objects = {e.meta.labels["scene_digest"]: e.meta.object for e in episodes if "scene_digest" in e.meta.labels}
    if len(objects) > 1:
        names = sorted(map(str, objects.values()))
        raise DataError(
            "the episodes are of several objects",
            expected="one object, as the scene has",
            found=", ".join(names),
            fix=f"candata registry filter DATASET \"object = '{names[0]}'\" --out NEW, then --scene SCENE+OBJECT",
        )


def _while_driven(episodes: list[Episode]) -> tuple[list[Episode], tuple[str, ...]]:
    """Return episodes that end where a servo is switched off, and a note on how many do: a replay goes on to follow."""
    kept, cut = [], 0
    for episode in episodes:
        off = np.flatnonzero(~episode["torque_on"].all(1)) if "torque_on" in episode else np.zeros(0, int)
        end = int(off[0]) if len(off) else len(episode)
        cut += end < len(episode)
        if end:
            kept.append(episode if end == len(episode) else piece(episode, 0, end))
    note = f"{cut} of {len(episodes)} episodes end where a servo is switched off: it follows no command any more"
    return kept, (note,) * bool(cut)


def _padded(values: Array, length: int, fill: float | None) -> Array:
    """Return values with rows appended up to `length`: of `fill`, or of the last row."""
    missing = length - len(values)
    tail = np.repeat(values[-1:], missing, axis=0) if fill is None else np.full((missing, *values.shape[1:]), fill)
    return np.concatenate([values, tail])


def title(dataset: Dataset) -> str:
    """Return a dataset's name with the start of its digest."""
    return f"{dataset.name}@{dataset.digest[:12]}"
