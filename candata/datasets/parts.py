"""Parts: up to a few hundred episodes in one folder that exists whole or not at all."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from candata.datasets import dense, durable, encode
from candata.datasets.bounded import read_parquet
from candata.errors import DataError, UsageError, Where
from candata.schema.episode import Episode
from candata.schema.manifest import FileEntry, PartEntry, PartFile

EPISODES_PER_ROW_GROUP = 8
#: What pyarrow and the decoding raise on bytes that are not what was written.
UNREADABLE = (pa.ArrowException, OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError)
STEPS, EPISODES, MANIFEST = "steps.parquet", "episodes.parquet", "part.json"


def write_part(path: str | Path, episodes: Iterable[Episode], producer: Mapping[str, str]) -> PartFile:
    """Return the manifest of a new part that holds `episodes`; it belongs to no version yet.

    Any number of processes may write parts to one dataset. At most 8 episodes are held at a time. The
    part's id follows from its content, so writing the same episodes again returns the part that stands.

    Parameters
    ----------
    path : str or Path
        Dataset.
    episodes : iterable of Episode
        At least one; ids unique; all with the same channels and shapes.
    producer : mapping of str to str
        What wrote it: words that may be published.

    Raises
    ------
    DataError
        When there are no episodes, an id comes twice, or the channels differ.
    SetupError
        When the folder of the dataset was moved away.
    """
    root = Path(path)
    with durable.staging_folder(root) as folder:
        pairs, rows = _write_tables(folder, episodes)
        tables = [folder / STEPS, folder / EPISODES]
        manifest = PartFile(
            id=part_id_of(pairs),
            files=tuple(_file_entry(folder, path) for path in [*tables, *dense.files(folder)]),
            rows=rows,
            episodes=tuple(pairs),
            producer=dict(producer),
        )
        (folder / MANIFEST).write_bytes(durable.encode_record(manifest))
        durable.sync(folder / MANIFEST)
        durable.sync(folder)
        return _commit(root, folder, manifest)


def _commit(root: Path, folder: Path, manifest: PartFile) -> PartFile:
    """Move a finished staging folder among the parts; return the manifest that stands there."""
    parts = durable.ensure_below(root, root / "parts")
    target = parts / manifest.id
    try:
        os.rename(folder, target)
    except OSError:
        if not target.is_dir():
            raise
        manifest = durable.read_record(PartFile, target / MANIFEST)
    durable.sync(parts)
    return manifest


def _write_tables(folder: Path, episodes: Iterable[Episode]) -> tuple[list[tuple[str, str]], int]:
    """Write both tables and the dense channels; return (id, content hash) pairs and the number of rows."""
    stream = iter(episodes)
    first_episode = next(stream, None)
    if first_episode is None:
        raise UsageError("nothing to write: no episodes", expected="at least 1 episode", fix="check the source")
    layout = encode.layout_of(first_episode)
    schema = encode.steps_schema(layout)
    table: list[dict[str, object]] = []
    stores = [dense.Writer(folder, name, shape) for name, shape in encode.dense_layout(layout).items()]
    with pq.ParquetWriter(folder / STEPS, schema, **encode.parquet_options(schema)) as writer:
        for number, group in enumerate(_groups(itertools.chain([first_episode], stream))):
            _check_group(group, layout, {str(row["id"]) for row in table})
            batches = [encode.steps_batch(episode, schema) for episode in group]
            steps = pa.Table.from_batches(batches)
            writer.write_table(steps, row_group_size=max(1, steps.num_rows))
            table += [encode.episode_row(e.meta, e["time_ns"], encode.content_hash(e), number) for e in group]
            for store, episode in itertools.product(stores, group):
                store.add(episode)
    pq.write_table(pa.Table.from_pylist(table, encode.EPISODE_COLUMNS), folder / EPISODES, compression="zstd")
    for store in stores:
        store.close()
    for name in (STEPS, EPISODES):
        durable.sync(folder / name)
    return [(str(r["id"]), str(r["content_hash"])) for r in table], sum(int(str(r["rows"])) for r in table)


def _groups(episodes: Iterator[Episode]) -> Iterator[list[Episode]]:
    """Yield the episodes in row groups."""
    while group := list(itertools.islice(episodes, EPISODES_PER_ROW_GROUP)):
        yield group


def _check_group(group: list[Episode], layout: encode.ColumnShapes, known_ids: set[str]) -> None:
    """Refuse an id that comes twice and an episode whose channels differ from the part's."""
    for episode in group:
        location = Where(episode=episode.meta.id)
        if episode.meta.id in known_ids:
            raise DataError("episode id comes twice in one part", expected="unique ids", where=location)
        known_ids.add(episode.meta.id)
        if encode.layout_of(episode) != layout:
            raise DataError(
                "episodes of one part differ in their channels",
                expected=_layout_text(layout),
                found=_layout_text(encode.layout_of(episode)),
                where=location,
                fix="write one part for each set of channels; append does so by itself",
            )


def _layout_text(layout: encode.ColumnShapes) -> str:
    """Return `name (shape), ...`."""
    return ", ".join(f"{name} {('T', *shape)}" for name, shape in layout.items())


def part_id_of(pairs: list[tuple[str, str]]) -> str:
    """Return the id that follows from a part's (episode id, content hash) pairs: equal parts are one part."""
    text = "\n".join(f"{name}\t{digest}" for name, digest in pairs)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _file_entry(folder: Path, path: Path) -> FileEntry:
    """Return a file's name in the part, size and hash."""
    return FileEntry(
        path=path.relative_to(folder).as_posix(), bytes=path.stat().st_size, sha256=durable.file_sha256(path)
    )


def part_folder(root: Path, part_id: str) -> Path:
    """Return the folder of a part."""
    return root / "parts" / part_id


def hold(root: Path, part_id: str) -> None:
    """Mark a part as being published: its age counts from now, so that gc leaves it alone.

    Raises
    ------
    DataError
        When there is no such part.
    """
    folder = part_folder(root, part_id)
    try:
        durable.touch(folder)
    except FileNotFoundError:
        raise durable.damaged_error(folder / MANIFEST, "no such file") from None


def entry_of(root: Path, part_id: str) -> PartEntry:
    """Return what a version says of a part that stands.

    Raises
    ------
    DataError
        When the part has no readable `part.json`; names the file.
    """
    path = part_folder(root, part_id) / MANIFEST
    data = durable.read_bytes(path)
    manifest = durable.read_record(PartFile, path, data)
    return PartEntry(
        id=part_id,
        sha256=hashlib.sha256(data).hexdigest(),
        rows=manifest.rows,
        episodes=len(manifest.episodes),
    )


@dataclass(frozen=True)
class RawPart:
    """A part of a version as it lies on the disk, unchecked.

    Attributes
    ----------
    root : Path
        Dataset.
    entry : PartEntry
        What the version says of it.
    """

    root: Path
    entry: PartEntry

    @property
    def folder(self) -> Path:
        """Folder of the part."""
        return part_folder(self.root, self.entry.id)

    def relative(self, path: Path | str | None) -> str:
        """Return a path below the dataset as seen from it, another one as it is."""
        full_path = Path(path or self.folder)
        return str(full_path.relative_to(self.root) if full_path.is_relative_to(self.root) else full_path)

    def manifest(self) -> PartFile:
        """Return `part.json`, which must be the one the version was published with.

        Raises
        ------
        DataError
            When it is missing, unreadable or another; names the file.
        """
        path = self.folder / MANIFEST
        data = durable.read_bytes(path)
        digest = hashlib.sha256(data).hexdigest()
        if digest != self.entry.sha256:
            raise durable.damaged_error(path, f"sha256 {digest[:12]}", f"sha256 {self.entry.sha256[:12]}")
        return durable.read_record(PartFile, path, data)

    def layout(self) -> encode.ColumnShapes:
        """Return each column's shape without the time axis, which all episodes of the part share.

        Raises
        ------
        DataError
            When `steps.parquet` is missing or unreadable; names it.
        """
        path = self.folder / STEPS
        try:
            return encode.stored_layout(pq.read_schema(path))
        except UNREADABLE as error:
            raise durable.damaged_error(path, durable.reason(error)) from None

    def table(self) -> pa.Table:
        """Return the rows of `episodes.parquet`.

        Raises
        ------
        DataError
            When the file is missing, unreadable, or unfolds to more than is read at once; names it.
        """
        path = self.folder / EPISODES
        try:
            return encode.episode_table(read_parquet(path))
        except UNREADABLE as error:
            raise durable.damaged_error(path, durable.reason(error)) from None

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of `episodes.parquet`, each with at least id, rows, row group, hash and record.

        Raises
        ------
        DataError
            When the file is missing or unreadable, or a row lacks one of these; names it.
        """
        path = self.folder / EPISODES
        try:
            rows = self.table().to_pylist()
        except UNREADABLE as error:
            raise durable.damaged_error(path, durable.reason(error)) from None
        for row in rows:
            missing_columns = [
                name for name in ("id", "rows", "row_group", "content_hash", "meta") if row[name] is None
            ]
            if missing_columns:
                raise durable.damaged_error(path, f"an episode without {', '.join(missing_columns)}")
        return rows

    def group(self, number: int, rows: list[dict[str, Any]] | None = None) -> list[encode.RawEpisode]:
        """Return the episodes of one row group as the tables hold them; `with_dense` adds what lies in Zarr stores.

        `rows` are those of `rows()`, if at hand.

        Raises
        ------
        DataError
            When a file is missing or does not decode; names it.
        """
        rows = self.rows() if rows is None else rows
        path = self.folder / STEPS
        try:
            steps = read_parquet(path, group=number)
            first_row = sum(int(row["rows"]) for row in rows if row["row_group"] < number)
            return encode.decode_group(steps, [row for row in rows if row["row_group"] == number], first_row)
        except UNREADABLE as error:
            raise durable.damaged_error(path, durable.reason(error)) from None

    def with_dense(self, episode: encode.RawEpisode) -> encode.RawEpisode:
        """Return an episode of `group` with its dense channels.

        Raises
        ------
        DataError
            When a store is missing or does not decode; names it.
        """
        if not episode.dense_shapes:
            return episode
        rows = slice(episode.first_row, episode.first_row + episode.rows)
        dense_arrays = {
            name: dense.read(self.folder, name, rows, shape) for name, shape in episode.dense_shapes.items()
        }
        return dataclasses.replace(episode, arrays={**episode.arrays, **dense_arrays})

    def episodes(self) -> Iterator[encode.RawEpisode]:
        """Yield the episodes as stored, at most the tables of 8 held at a time.

        Raises
        ------
        DataError
            When a file is missing or does not decode; names it.
        """
        rows = self.rows()
        for number in sorted({row["row_group"] for row in rows}):
            yield from map(self.with_dense, self.group(number, rows))

    def changed_file(self, manifest: PartFile) -> DataError | None:
        """Return what is wrong with the bytes of the part's files; reads all of them."""
        for entry in manifest.files:
            path = self.folder / entry.path
            try:
                digest = durable.file_sha256(path)
            except OSError as error:
                return durable.damaged_error(path, durable.reason(error))
            if digest != entry.sha256:
                return durable.damaged_error(path, f"sha256 {digest[:12]}", f"sha256 {entry.sha256[:12]}")
        return None

    def size_problem(self, manifest: PartFile) -> DataError | None:
        """Return what is wrong with the presence or size of the part's files, without reading them."""
        for entry in manifest.files:
            path = self.folder / entry.path
            if not path.is_file():
                return durable.damaged_error(path, "no such file")
            if path.stat().st_size != entry.bytes:
                return durable.damaged_error(path, f"{path.stat().st_size} bytes", f"{entry.bytes} bytes")
        return None
