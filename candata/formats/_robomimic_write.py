"""Episodes as a robomimic HDF5 file."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from candata.errors import MissingExtraError, SetupError, Where
from candata.formats import Writing
from candata.formats._packing import ColumnSurvey, filled_columns, survey
from candata.formats._robomimic_read import SIDECAR
from candata.formats._sidecar import exported_episode, sidecar, text
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Episode

FILE = "dataset.hdf5"
#: robomimic asks what kind of environment made the data; 2 is gym. Source: robomimic, `envs/env_base.py`.
_GYM = 2


def write(episodes: Iterable[Episode], folder: Path, writing: Writing) -> None:
    """Write the episodes into `dataset.hdf5` in an empty folder; they are read twice.

    Raises
    ------
    DataError
        When the episodes differ in rate, or in number or names of joints, actuators or fingertips.
    MissingExtraError
        When h5py is not installed.
    SetupError
        When the disk is full.
    """
    try:
        import h5py
    except ImportError:
        raise MissingExtraError("h5py", "formats") from None
    column_survey = survey(episodes)
    with closing(_Sink(folder / FILE)) as sink:
        try:
            # Attributes beyond 64 KB need the file format of HDF5 1.8.
            with h5py.File(sink, "w", libver=("v108", "v108")) as file:
                _write_file(file.create_group("data"), episodes, column_survey, writing, sink)
        finally:
            sink.require_whole()  # whatever HDF5 made of bytes that the disk has not taken
    for line in (*column_survey.notes, *_limits(column_survey)):
        writing.note(line)


def _write_file(
    data: Any, episodes: Iterable[Episode], column_survey: ColumnSurvey, writing: Writing, sink: _Sink
) -> None:
    """Write all demonstrations, their masks, and what tells of them."""
    data.attrs["total"] = column_survey.rows
    data.attrs[SIDECAR] = text(
        sidecar(writing, {name: key_of(name) for name in column_survey.columns}, column_survey.clouds)
    )
    masks: dict[str, list[str]] = {}
    scenes: list[str] = []
    for index, episode in enumerate(episodes):
        name = f"demo_{index}"
        _write_demo(data.create_group(name), episode, column_survey)
        masks.setdefault(episode.meta.source, []).append(name)
        sink.require_whole()
        scenes.append(episode.meta.scene or "unknown")
    for source, names in masks.items():
        data.file.create_dataset(f"mask/{source}", data=np.array(names, dtype="S"))
    data.attrs["env_args"] = _env_args(scenes, column_survey)


def key_of(column: str) -> str:
    """Return where a column lies in a demonstration."""
    if column.endswith(VALID_SUFFIX):
        return f"valid/{column.removesuffix(VALID_SUFFIX)}"
    return {"action": "actions", "time_ns": "time_ns"}.get(column, f"obs/{column}")


def _write_demo(group: Any, episode: Episode, column_survey: ColumnSurvey) -> None:
    """Write one demonstration."""
    for name, array in filled_columns(episode, column_survey).items():
        group.create_dataset(key_of(name), data=array)
    rows = len(episode)
    group.create_dataset("rewards", data=np.zeros(rows))
    group.create_dataset("dones", data=(np.arange(rows) == rows - 1).astype(np.int64))
    group.attrs["num_samples"] = rows
    group.attrs[SIDECAR] = text(exported_episode(episode))


def _env_args(scenes: list[str], column_survey: ColumnSurvey) -> str:
    """Return what robomimic wants to know of the environment."""
    name = ", ".join(dict.fromkeys(scenes))
    return json.dumps({"env_name": name, "type": _GYM, "env_kwargs": {"control_freq": column_survey.rate_hz}})


def _limits(column_survey: ColumnSurvey) -> Iterable[str]:
    """Yield what robomimic's own files have and these have not."""
    yield "rewards are zero and dones mark the last row, as candata keeps neither"
    yield "left out: states, model_file and next_obs; train with hdf5_load_next_obs: false"
    if "action" not in column_survey.columns:
        yield "the episodes have no action, and so the file has no `actions`"


class _Sink(io.RawIOBase):
    """A new file that never refuses a write of HDF5, which ends the process where one is; the refusal is kept.

    What was not taken reads as zeros.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("xb+", buffering=0)
        self._refused: OSError | None = None

    def require_whole(self) -> None:
        """Refuse to go on once the disk has not taken something.

        Raises
        ------
        SetupError
            When it has not.
        """
        if self._refused is not None:
            raise SetupError(
                "the file cannot be written",
                found=self._refused.strerror,
                where=Where(path=str(self._path)),
                fix="free space, or choose another --out",
            ) from None

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to a place."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the place."""
        return self._file.tell()

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer."""
        view, count = memoryview(buffer).cast("B"), 0
        while count < len(view) and (read_count := self._file.readinto(view[count:])):
            count += read_count
        view[count:] = bytes(len(view) - count)
        return len(view)

    def write(self, data: Any) -> int:
        """Write all of the data, or keep why not."""
        view, count = memoryview(data).cast("B"), 0
        try:
            while self._refused is None and count < len(view):
                count += self._file.write(view[count:]) or 0
        except OSError as error:
            self._refused = error
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Give the file a size, or keep why not."""
        try:
            return self._file.truncate(size)
        except OSError as error:
            self._refused = self._refused or error
            return size or 0

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()
