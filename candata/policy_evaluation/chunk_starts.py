"""Starts of command chunks: instants of held-out episodes from which other commands are planned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, UsageError, Where
from candata.loaders import Windows
from candata.training.forecasters import COMMANDS_PLANNED, NOISE_NUMBERS

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ChunkStarts:
    """S instants of recorded episodes, one an episode.

    Attributes
    ----------
    windows : Windows
        What a forecaster sees of them, at its own rate.
    """

    windows: Windows

    def __len__(self) -> int:
        """Return the number of starts S."""
        return len(self.windows)

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the episodes."""
        return tuple(self.windows.episode_ids[episode] for episode in self.windows.owner.tolist())

    @property
    def numbers(self) -> Index:
        """`(S,)` numbers of the episodes in the data set: what a start draws is seeded by its own."""
        number = {name: k for k, name in enumerate(self.windows.dataset.ids)}
        return np.array([number[name] for name in self.ids], np.int64)

    @property
    def previous(self) -> Array:
        """`(S, A)` the commands of the row before each start."""
        return self._commands(np.array([-1]))[:, 0]

    def recorded(self, rows: int) -> Array:
        """Return the commands `(S, rows, A)` that were recorded from each start on; the last of an episode holds."""
        return self._commands(np.arange(rows))

    def native(self, rows: int) -> ChunkStarts:
        """Return the same starts at the episodes' own rate, with `rows` rows ahead: what a simulator is given."""
        windows = self.windows
        stride = int(windows.stride[windows.owner[0]])
        return ChunkStarts(
            replace(
                windows,
                history=(windows.history - 1) * stride + 1,
                horizon=rows,
                rate_hz=windows.rate_hz * stride,
                stride=np.ones_like(windows.stride),
            )
        )

    def batch(self, commands: Array) -> dict[str, NDArray]:
        """Return the windows `(S * N, ...)` in which commands `(S, N, R, A)` at the episodes' own rate are planned.

        The command at the present is part of the plan: it is held from the present on. Nothing that was recorded
        after the present is left but the `future/` entries, which no forecast reads. All chunks of a start draw from
        its own stream: what is forecast depends on no other start, and chunks are compared with the same noise.
        """
        windows = self.windows
        numbers = np.repeat(np.arange(len(self)), commands.shape[1])
        batch = windows.batch(numbers)
        flat = commands.reshape(len(numbers), *commands.shape[2:])
        stride = int(windows.stride[windows.owner[0]])
        rows = np.minimum(np.arange(windows.horizon) * stride, flat.shape[1] - 1)
        planned = flat[:, rows].astype(np.float32)
        history = batch["history/action"].copy()
        history[:, -1] = planned[:, 0]
        batch |= {"planned/action": planned, "history/action": history, COMMANDS_PLANNED: flat}
        batch[NOISE_NUMBERS] = self.numbers[numbers]
        batch["future_pad"] = np.zeros_like(batch["future_pad"])
        return batch

    def _commands(self, offsets: Index) -> Array:
        """Return recorded commands `(S, n, A)` at rows from each start, within its episode."""
        windows, cache = self.windows, self.windows.cache
        rows = windows.present_row[:, None] + offsets
        rows = rows.clip(cache.begin[windows.owner][:, None], cache.end[windows.owner][:, None] - 1)
        return np.asarray(cache.rows["action"][rows], np.float64)


def chunk_starts(windows: Windows, count: int, at_s: float | None = None) -> ChunkStarts:
    """Return the starts of at most `count` episodes, evenly spread over those of the windows.

    Parameters
    ----------
    windows : Windows
        Of held-out episodes.
    count : int
        Most starts.
    at_s : float, optional
        Time after an episode's first row [s]; by default the first row with a whole history.

    Raises
    ------
    DataError
        When no episode has a whole valid history there, or they differ in rate.
    UsageError
        When the time lies before the first row with a whole history.
    """
    cache, episodes = windows.cache, np.unique(windows.owner)
    if len(set(windows.stride[episodes].tolist())) > 1:
        raise DataError("the episodes differ in rate", expected="one rate", where=Where(path=str(windows.dataset.path)))
    stride = int(windows.stride[episodes[0]])
    lead = (windows.history - 1) * stride
    offset = lead if at_s is None else round(at_s * windows.rate_hz * stride)
    if offset < lead:
        raise UsageError(
            "a start lies before the first whole history",
            expected=f"--at {lead / (windows.rate_hz * stride):g} or later",
            found=f"{at_s:g}",
        )
    rows = cache.begin[episodes] + offset
    whole = np.array(
        [
            row < cache.end[episode] - 1 and bool(cache.valid[row - lead : row + 1].all())
            for row, episode in zip(rows.tolist(), episodes.tolist(), strict=True)
        ],
        bool,
    )
    episodes, rows = episodes[whole], rows[whole]
    if not len(episodes):
        raise DataError(
            "no episode has a start",
            expected=f"valid rows over {lead + 1} rows up to row {offset}, and rows after it",
            where=Where(path=str(windows.dataset.path)),
            fix="give another --at, or a split with longer episodes",
        )
    chosen = np.unique(np.linspace(0, len(episodes) - 1, min(count, len(episodes))).round().astype(int))
    return ChunkStarts(replace(windows, present_row=rows[chosen], owner=episodes[chosen]))
