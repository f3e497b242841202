"""Episodes as a Diffusion Policy buffer: a zarr group of format 2, all episodes end to end."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import zarr
from numpy.typing import NDArray

from candata.formats import Writing
from candata.formats._diffusion_policy_read import SIDECAR
from candata.formats._packing import ColumnSurvey, as_matrix, filled_columns, packed_state, state_names, survey
from candata.formats._sidecar import exported_episode, sidecar, text
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Episode
from candata.schema.exchange import ExportedEpisode

FOLDER = "replay_buffer.zarr"
#: Size of a chunk, cut along time alone. Source: diffusion_policy, `replay_buffer.get_optimal_chunks`.
_CHUNK_BYTES = 2_000_000


def write(episodes: Iterable[Episode], folder: Path, writing: Writing) -> None:
    """Write the episodes into `replay_buffer.zarr` in an empty folder; they are read twice.

    Raises
    ------
    DataError
        When the episodes differ in rate, or in number or names of joints, actuators or fingertips.
    """
    column_survey = survey(episodes)
    root = zarr.open_group(store=str(folder / FOLDER), mode="w", zarr_format=2)
    data, meta = root.create_group("data"), root.create_group("meta")
    sidecar_entries: list[ExportedEpisode] = []
    ends: list[int] = []
    buffers: dict[str, _Column] = {}
    for episode in episodes:
        for key, values in _arrays(episode, column_survey):
            if key not in buffers:
                buffers[key] = _Column(_create(data, key, values, column_survey.rows))
            buffers[key].add(values)
        sidecar_entries.append(exported_episode(episode))
        ends.append((ends[-1] if ends else 0) + len(episode))
    for column in buffers.values():
        column.flush()
    meta.create_array("episode_ends", data=np.array(ends, np.int64), compressors=None)
    keys = {name: key_of(name) for name in column_survey.columns}
    root.attrs[SIDECAR] = text(sidecar(writing, keys, column_survey.clouds, sidecar_entries))
    for line in column_survey.notes:
        writing.note(line)


def key_of(column: str) -> str:
    """Return the array in which a column lies."""
    return f"valid_{column.removesuffix(VALID_SUFFIX)}" if column.endswith(VALID_SUFFIX) else column


def _arrays(episode: Episode, column_survey: ColumnSurvey) -> Iterator[tuple[str, NDArray]]:
    """Yield every array of an episode, the packed `state` first."""
    columns = filled_columns(episode, column_survey)
    if state_names(column_survey):
        yield "state", packed_state(columns, column_survey)
    for name, values in columns.items():
        yield key_of(name), values if values.ndim > 1 else as_matrix(values)


def _create(group: zarr.Group, key: str, values: NDArray, rows: int) -> zarr.Array:
    """Return a new array of `rows` rows, chunked along time."""
    row_bytes = max(1, values.itemsize * int(np.prod(values.shape[1:])))
    length = max(1, min(rows, -(-_CHUNK_BYTES // row_bytes)))
    return group.create_array(
        key, shape=(rows, *values.shape[1:]), chunks=(length, *values.shape[1:]), dtype=values.dtype
    )


class _Column:
    """An array that is written by whole chunks, as its rows come."""

    def __init__(self, array: zarr.Array) -> None:
        """Begin at the first row."""
        self._array, self._held, self._start, self._rows = array, [], 0, 0  # type: ignore[var-annotated]

    def add(self, values: NDArray) -> None:
        """Take the next rows."""
        self._held.append(values)
        self._rows += len(values)
        length = self._array.chunks[0]
        if self._rows >= length:
            rows = np.concatenate(self._held)
            full_rows = len(rows) // length * length
            self._write(rows[:full_rows])
            self._held, self._rows = [rows[full_rows:]], len(rows) - full_rows

    def flush(self) -> None:
        """Write the rest."""
        if self._rows:
            self._write(np.concatenate(self._held))

    def _write(self, values: NDArray) -> None:
        """Write rows after those that were written."""
        self._array[self._start : self._start + len(values)] = values
        self._start += len(values)
