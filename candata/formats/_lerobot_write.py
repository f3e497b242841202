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
from candata.formats._lerobot_layout import BOOKKEEPING, INFO, SIDECAR
from candata.formats._lerobot_names import ACTION, PREFIX, STATE
from candata.formats._lerobot_stats import Stats, Tally
from candata.formats._packing import Survey, column_names, filled, flat, packed_state, state_names, survey
from candata.formats._sidecar import exported, sidecar, text
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import Episode

#: A data file is closed beyond this size in memory; files a folder. Source: lerobot, `datasets/utils.py`.
_FILE_BYTES, _FILE_MEGABYTES, _CHUNK = 100 << 20, 100, 1000
#: Rows of `meta/episodes` a file: each holds an episode's statistics.
_EPISODES_A_FILE = 1000
_DTYPES = {"timestamp": "float32"}


class Layout(Protocol):
    """Where the rows of episodes go."""

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
    found = survey(episodes)
    features = _features(found)
    layout: Layout = _PerEpisode(folder) if writing.variant == "v21" else _Shared(folder, _schema(features))
    tally = Tally(found.rows, sum(int(one["shape"][0]) for one in features.values()))
    tasks: dict[str, int] = {}
    kept = []
    start = 0
    for index, episode in enumerate(episodes):
        task = episode.meta.task or ""
        place = (index, start, tasks.setdefault(task, len(tasks)))
        arrays = _arrays(episode, found, place)
        layout.episode(index, _table(arrays, features), task, tally.add(arrays))
        kept.append(exported(episode))
        start += len(episode)
    for line in found.notes:
        writing.note(line)
    layout.finish(_info(found, features, len(tasks)), list(tasks), tally.total())
    keys = {name: key_of(name) for name in found.columns}
    (folder / SIDECAR).write_text(text(sidecar(writing, keys, found.clouds, kept)), encoding="utf-8")


def key_of(column: str) -> str:
    """Return the key under which a column lies."""
    if column.endswith(VALID_SUFFIX):
        return f"valid.{column.removesuffix(VALID_SUFFIX)}"
    return column if column in (ACTION, "time_ns") else PREFIX + column


def _features(found: Survey) -> dict[str, dict[str, Any]]:
    """Return the features of `meta/info.json`, the bookkeeping last."""
    state = state_names(found)
    made = {STATE: _feature("float32", state)} if state else {}
    for name in found.columns:
        dtype = "bool" if name.endswith(VALID_SUFFIX) else CHANNELS[name].dtype
        made[key_of(name)] = _feature(dtype, [name] if name.endswith(VALID_SUFFIX) else column_names(name, found))
    return made | {name: _feature(_DTYPES.get(name, "int64"), [name]) | {"names": None} for name in BOOKKEEPING}


def _feature(dtype: str, names: list[str]) -> dict[str, Any]:
    """Return a feature of one row of columns."""
    return {"dtype": dtype, "shape": [len(names)], "names": names}


def _arrays(episode: Episode, found: Survey, place: tuple[int, int, int]) -> dict[str, NDArray]:
    """Return each feature of an episode as `(T, n)`; `place` is its number, its first row, its task."""
    index, start, task = place
    own = filled(episode, found)
    frames = np.arange(len(episode))
    made: dict[str, NDArray] = {STATE: packed_state(own, found)} if state_names(found) else {}
    made |= {key_of(name): flat(array) for name, array in own.items()}
    made |= {
        "timestamp": (frames / found.rate_hz).astype(np.float32)[:, None],
        "frame_index": frames[:, None],
        "episode_index": np.full((len(frames), 1), index),
        "index": (start + frames)[:, None],
        "task_index": np.full((len(frames), 1), task),
    }
    return made


def _schema(features: Mapping[str, Mapping[str, Any]]) -> pa.Schema:
    """Return the columns of a data file: numbers, or lists of one length."""
    kinds = {name: pa.from_numpy_dtype(np.dtype(one["dtype"])) for name, one in features.items()}
    return pa.schema({n: k if features[n]["shape"] == [1] else pa.list_(k, features[n]["shape"][0])
                      for n, k in kinds.items()})  # fmt: skip


def _table(arrays: Mapping[str, NDArray], features: Mapping[str, Mapping[str, Any]]) -> pa.Table:
    """Return the rows of one episode."""
    columns = []
    schema = _schema(features)
    for one in schema:
        values = pa.array(arrays[one.name].reshape(-1))
        lists = pa.types.is_fixed_size_list(one.type)
        columns.append(pa.FixedSizeListArray.from_arrays(values, one.type.list_size) if lists else values)
    return pa.Table.from_arrays(columns, schema=schema)


def _info(found: Survey, features: dict[str, dict[str, Any]], tasks: int) -> dict[str, Any]:
    """Return what both layouts say in `meta/info.json`."""
    fps = int(found.rate_hz) if float(found.rate_hz).is_integer() else found.rate_hz
    return {
        "robot_type": None,
        "total_episodes": found.episodes,
        "total_frames": found.rows,
        "total_tasks": tasks,
        "chunks_size": _CHUNK,
        "fps": fps,
        "splits": {"train": f"0:{found.episodes}"},
        "features": features,
    }


@dataclass
class _Shared:
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
        own = {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": index // _EPISODES_A_FILE}
        flat_stats = {f"stats/{key}/{name}": v for key, one in stats.items() for name, v in one.items()}
        self.rows.append(
            {"episode_index": index, "tasks": [task], "length": len(table), **file, **places, **own, **flat_stats}
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
        own = {"codebase_version": "v3.0"} | info
        own |= {"data_files_size_in_mb": _FILE_MEGABYTES, "video_files_size_in_mb": 200}
        own |= {"data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", "video_path": None}
        _write_json(self.folder / INFO, own)

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
        plain = {key: {n: v for n, v in one.items() if not n.startswith("q")} for key, one in stats.items()}
        self.stats.append({"episode_index": index, "stats": plain})

    def finish(self, info: dict[str, Any], tasks: list[str], stats: Stats) -> None:
        """Write what is known at the end."""
        meta = self.folder / "meta"
        meta.mkdir(exist_ok=True)
        _write_lines(meta / "episodes.jsonl", self.lines)
        _write_lines(meta / "episodes_stats.jsonl", self.stats)
        _write_lines(meta / "tasks.jsonl", [{"task_index": k, "task": task} for k, task in enumerate(tasks)])
        chunks = -(-len(self.lines) // _CHUNK)
        own = {"codebase_version": "v2.1"} | info | {"total_videos": 0, "total_chunks": chunks}
        own |= {"data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet", "video_path": None}
        _write_json(self.folder / INFO, own)


def _write_tasks(path: Path, tasks: list[str]) -> None:
    """Write the tasks so that pandas takes their texts for the index, as lerobot expects."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, (kind, numpy) in kinds.items()
    ]
    about = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks, pa.string())})
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(about)}), path)


def _write_json(path: Path, value: object) -> None:
    """Write indented JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False, allow_nan=False), encoding="utf-8")


def _write_lines(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write a JSON value a line."""
    lines = [json.dumps(row, ensure_ascii=False, allow_nan=False) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
