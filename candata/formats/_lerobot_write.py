"""Episodes as a LeRobot set: v3.0, or v2.1 with a file an episode."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from candata.formats import Writing
from candata.formats._lerobot_layout import BOOKKEEPING_COLUMNS, INFO, SIDECAR
from candata.formats._lerobot_names import ACTION, PREFIX, STATE
from candata.formats._lerobot_stats import FeatureTally, Stats
from candata.formats._packing import (
    ColumnSurvey,
    as_matrix,
    column_names,
    filled_columns,
    packed_state,
    state_names,
    survey,
)
from candata.formats._sidecar import exported_episode, sidecar, text
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import Episode

#: A data file is closed beyond this size in memory; files a folder. Source: lerobot, `datasets/utils.py`.
_FILE_BYTES, _FILE_MEGABYTES, _CHUNK = 100 << 20, 100, 1000
#: Rows of `meta/episodes` a file: each holds an episode's statistics.
_EPISODES_A_FILE = 1000
_DTYPES = {"timestamp": "float32"}


class SetWriter(Protocol):
    """Writer of the files of a set, in one of the two layouts."""

    def episode(self, index: int, table: pa.Table, task: str, stats: Stats) -> None:
        """Write one episode."""

    def finish(self, info: dict[str, Any], tasks: list[str], stats: Stats) -> None:
        """Write what is known at the end."""


def write(episodes: Iterable[Episode], folder: Path, writing: Writing) -> None:
    """Write the episodes into an empty folder; they are read twice.

    Raises
    ------
    DataError
        When the episodes differ in rate, or in number or names of joints, actuators or fingertips.
    """
    column_survey = survey(episodes)
    features = _features(column_survey)
    layout: SetWriter = _PerEpisode(folder) if writing.variant == "v21" else _SharedFiles(folder, _schema(features))
    tally = FeatureTally(column_survey.rows, sum(int(feature["shape"][0]) for feature in features.values()))
    tasks: dict[str, int] = {}
    sidecar_entries = []
    start = 0
    for index, episode in enumerate(episodes):
        task = episode.meta.task or ""
        place = (index, start, tasks.setdefault(task, len(tasks)))
        arrays = _arrays(episode, column_survey, place)
        layout.episode(index, _table(arrays, features), task, tally.add(arrays))
        sidecar_entries.append(exported_episode(episode))
        start += len(episode)
    for line in column_survey.notes:
        writing.note(line)
    layout.finish(_info(column_survey, features, len(tasks)), list(tasks), tally.total())
    keys = {name: key_of(name) for name in column_survey.columns}
    (folder / SIDECAR).write_text(text(sidecar(writing, keys, column_survey.clouds, sidecar_entries)), encoding="utf-8")


def key_of(column: str) -> str:
    """Return the key under which a column lies."""
    if column.endswith(VALID_SUFFIX):
        return f"valid.{column.removesuffix(VALID_SUFFIX)}"
    return column if column in (ACTION, "time_ns") else PREFIX + column


def _features(column_survey: ColumnSurvey) -> dict[str, dict[str, Any]]:
    """Return the features of `meta/info.json`, the bookkeeping last."""
    state = state_names(column_survey)
    features = {STATE: _feature("float32", state)} if state else {}
    for name in column_survey.columns:
        dtype = "bool" if name.endswith(VALID_SUFFIX) else CHANNELS[name].dtype
        features[key_of(name)] = _feature(
            dtype, [name] if name.endswith(VALID_SUFFIX) else column_names(name, column_survey)
        )
    return features | {
        name: _feature(_DTYPES.get(name, "int64"), [name]) | {"names": None} for name in BOOKKEEPING_COLUMNS
    }


def _feature(dtype: str, names: list[str]) -> dict[str, Any]:
    """Return a feature of one row of columns."""
    return {"dtype": dtype, "shape": [len(names)], "names": names}


def _arrays(episode: Episode, column_survey: ColumnSurvey, place: tuple[int, int, int]) -> dict[str, NDArray]:
    """Return each feature of an episode as `(T, n)`; `place` is its number, its first row, its task."""
    index, start, task = place
    columns = filled_columns(episode, column_survey)
    frames = np.arange(len(episode))
    arrays: dict[str, NDArray] = {STATE: packed_state(columns, column_survey)} if state_names(column_survey) else {}
    arrays |= {key_of(name): as_matrix(array) for name, array in columns.items()}
    arrays |= {
        "timestamp": (frames / column_survey.rate_hz).astype(np.float32)[:, None],
        "frame_index": frames[:, None],
        "episode_index": np.full((len(frames), 1), index),
        "index": (start + frames)[:, None],
        "task_index": np.full((len(frames), 1), task),
    }
    return arrays


def _schema(features: Mapping[str, Mapping[str, Any]]) -> pa.Schema:
    """Return the columns of a data file: numbers, or lists of one length."""
    kinds = {name: pa.from_numpy_dtype(np.dtype(feature["dtype"])) for name, feature in features.items()}
    return pa.schema(
        {n: k if features[n]["shape"] == [1] else pa.list_(k, features[n]["shape"][0]) for n, k in kinds.items()}
    )


def _table(arrays: Mapping[str, NDArray], features: Mapping[str, Mapping[str, Any]]) -> pa.Table:
    """Return the rows of one episode."""
    columns = []
    schema = _schema(features)
    for column in schema:
        values = pa.array(arrays[column.name].reshape(-1))
        lists = pa.types.is_fixed_size_list(column.type)
        columns.append(pa.FixedSizeListArray.from_arrays(values, column.type.list_size) if lists else values)
    return pa.Table.from_arrays(columns, schema=schema)


def _info(column_survey: ColumnSurvey, features: dict[str, dict[str, Any]], tasks: int) -> dict[str, Any]:
    """Return what both layouts say in `meta/info.json`."""
    fps = int(column_survey.rate_hz) if float(column_survey.rate_hz).is_integer() else column_survey.rate_hz
    return {
        "robot_type": None,
        "total_episodes": column_survey.episodes,
        "total_frames": column_survey.rows,
        "total_tasks": tasks,
        "chunks_size": _CHUNK,
        "fps": fps,
        "splits": {"train": f"0:{column_survey.episodes}"},
        "features": features,
    }


@dataclass
class _SharedFiles:
    """v3.0: files of many episodes, one row group an episode."""

    folder: Path
    schema: pa.Schema
    writer: pq.ParquetWriter | None = None
    number: int = -1
    bytes: int = 0
    start: int = 0
    rows: list[dict[str, Any]] = field(default_factory=list)

    def episode(self, index: int, table: pa.Table, task: str, stats: Stats) -> None:
        """Write one episode."""
        if self.writer is None or self.bytes > _FILE_BYTES:
            self._next_file()
        if self.writer is not None:
            self.writer.write_table(table)
        self.bytes += table.nbytes
        file = {"data/chunk_index": self.number // _CHUNK, "data/file_index": self.number % _CHUNK}
        places = {"dataset_from_index": self.start, "dataset_to_index": self.start + len(table)}
        meta_file = {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": index // _EPISODES_A_FILE}
        flat_stats = {f"stats/{key}/{name}": v for key, values in stats.items() for name, v in values.items()}
        self.rows.append(
            {"episode_index": index, "tasks": [task], "length": len(table), **file, **places, **meta_file, **flat_stats}
        )
        self.start += len(table)
        if len(self.rows) == _EPISODES_A_FILE:
            self._flush()

    def finish(self, info: dict[str, Any], tasks: list[str], stats: Stats) -> None:
        """Write what is known at the end."""
        if self.writer is not None:
            self.writer.close()
        self._flush()
        _write_tasks(self.folder / "meta" / "tasks.parquet", tasks)
        _write_json(self.folder / "meta" / "stats.json", stats)
        info_json = {"codebase_version": "v3.0"} | info
        info_json |= {"data_files_size_in_mb": _FILE_MEGABYTES, "video_files_size_in_mb": 200}
        info_json |= {"data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", "video_path": None}
        _write_json(self.folder / INFO, info_json)

    def _next_file(self) -> None:
        """Close the file of rows and open the next."""
        if self.writer is not None:
            self.writer.close()
        self.number += 1
        self.bytes = 0
        path = self.folder / "data" / f"chunk-{self.number // _CHUNK:03d}" / f"file-{self.number % _CHUNK:03d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        self.writer = pq.ParquetWriter(path, self.schema, compression="snappy", write_page_checksum=True)

    def _flush(self) -> None:
        """Write the gathered rows of `meta/episodes`."""
        if not self.rows:
            return
        number = self.rows[0]["meta/episodes/file_index"]
        path = self.folder / "meta" / "episodes" / "chunk-000" / f"file-{number:03d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.Table.from_pylist(self.rows), path, compression="snappy", write_page_checksum=True)
        self.rows.clear()


@dataclass
class _PerEpisode:
    """v2.1: a file an episode."""

    folder: Path
    lines: list[dict[str, Any]] = field(default_factory=list)
    stats: list[dict[str, Any]] = field(default_factory=list)

    def episode(self, index: int, table: pa.Table, task: str, stats: Stats) -> None:
        """Write one episode."""
        path = self.folder / "data" / f"chunk-{index // _CHUNK:03d}" / f"episode_{index:06d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, path, compression="snappy", write_page_checksum=True)
        self.lines.append({"episode_index": index, "tasks": [task], "length": len(table)})
        stats_without_quantiles = {
            key: {n: v for n, v in values.items() if not n.startswith("q")} for key, values in stats.items()
        }
        self.stats.append({"episode_index": index, "stats": stats_without_quantiles})

    def finish(self, info: dict[str, Any], tasks: list[str], stats: Stats) -> None:
        """Write what is known at the end."""
        meta = self.folder / "meta"
        meta.mkdir(exist_ok=True)
        _write_lines(meta / "episodes.jsonl", self.lines)
        _write_lines(meta / "episodes_stats.jsonl", self.stats)
        _write_lines(meta / "tasks.jsonl", [{"task_index": k, "task": task} for k, task in enumerate(tasks)])
        chunks = -(-len(self.lines) // _CHUNK)
        info_json = {"codebase_version": "v2.1"} | info | {"total_videos": 0, "total_chunks": chunks}
        info_json |= {
            "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
            "video_path": None,
        }
        _write_json(self.folder / INFO, info_json)


def _write_tasks(path: Path, tasks: list[str]) -> None:
    """Write the tasks so that pandas takes their texts for the index, as lerobot expects."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, (kind, numpy) in kinds.items()
    ]
    pandas_metadata = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks, pa.string())})
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas_metadata)}), path)


def _write_json(path: Path, value: object) -> None:
    """Write indented JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False, allow_nan=False), encoding="utf-8")


def _write_lines(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write a JSON value a line."""
    lines = [json.dumps(row, ensure_ascii=False, allow_nan=False) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
