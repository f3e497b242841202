"""Dataset: one version, open for reading."""

from __future__ import annotations

import hashlib
import operator
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple, overload

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from candata.datasets import durable, encode
from candata.datasets.bounded import read_parquet
from candata.datasets.encode import RawEpisode
from candata.datasets.parts import EPISODES_PER_ROW_GROUP, STEPS, RawPart
from candata.datasets.versions import digest_of, find_version, numbers, read_dataset_file, read_version, version_path
from candata.errors import DataError, SetupError, UnknownNameError, Where
from candata.schema.episode import Episode
from candata.schema.html_text import MOST_ROWS, summary_table
from candata.schema.manifest import Lineage, VersionFile

#: Decoded row groups (without dense channels) that an iteration keeps, for ids whose order is not that of the parts.
_GROUPS_HELD = 8


class EpisodePlace(NamedTuple):
    """The place of an episode: its part and its position in it."""

    part: RawPart
    position: int
    content_hash: str

    @property
    def group(self) -> int:
        """Number of its row group."""
        return self.position // EPISODES_PER_ROW_GROUP


@dataclass(frozen=True, eq=False)
class Dataset:
    """One version of a dataset.

    Attributes
    ----------
    path : Path
        Folder.
    name : str
        Name of the dataset.
    file : VersionFile
        The version as published.
    places : mapping of str to EpisodePlace
        Episode id to its place.
    """

    path: Path
    name: str
    file: VersionFile
    places: dict[str, EpisodePlace]

    @property
    def version(self) -> int:
        """Number of the version."""
        return self.file.number

    @property
    def digest(self) -> str:
        """sha256 over the sorted (episode id, content hash): equal for equal content."""
        return self.file.digest

    @property
    def digests(self) -> tuple[str, ...]:
        """Digests of this version and of those before it, the newest first."""
        older = [number for number in numbers(self.path) if number < self.version]
        return (self.digest, *(read_version(self.path, number).digest for number in reversed(older)))

    @property
    def lineage(self) -> tuple[Lineage, ...]:
        """How the episodes came to be, the first operation first."""
        return self.file.lineage

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Episode ids, sorted: the order of iteration, independent of who wrote which part when."""
        return tuple(sorted(self.places))

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.places)

    def __iter__(self) -> Iterator[Episode]:
        """Yield all episodes in the order of `ids`."""
        return self.episodes()

    def __contains__(self, id: object) -> bool:
        """Tell whether an episode with this id is in the version."""
        return id in self.places

    @overload
    def __getitem__(self, key: int | str) -> Episode: ...

    @overload
    def __getitem__(self, key: slice) -> list[Episode]: ...

    def __getitem__(self, key: int | str | slice) -> Episode | list[Episode]:
        """Return the episode at a place in the order of `ids` or with an id, or the list of episodes of a slice.

        Raises
        ------
        IndexError
            When there is no such place.
        UnknownNameError
            When the id is not in this version.
        DataError
            When a part is damaged; names the file.
        """
        if isinstance(key, str):
            return self.episode(key)
        if isinstance(key, slice):
            return list(self.episodes(self.ids[key]))
        if not -len(self) <= operator.index(key) < len(self):
            raise IndexError(f"episode {key} of {self.name}: it has {len(self):,} (0 to {len(self) - 1:,})")
        return self.episode(self.ids[key])

    def __repr__(self) -> str:
        """Return name, version and size in one line."""
        return f"Dataset({self.name!r}, version {self.version}, {len(self):,} episodes, digest {self.digest[:12]})"

    def _repr_html_(self) -> str:
        """Return the first episodes as a table: what a notebook shows."""
        columns = ("id", "source", "scene", "object", "task", "outcome", "rows")
        first_rows = self.catalog(columns).slice(0, MOST_ROWS).to_pylist()
        rows = [["" if row[name] is None else row[name] for name in columns] for row in first_rows]
        facts = f"version {self.version}, digest {self.digest[:12]}, {len(self):,} episodes, {self.path}"
        return summary_table(f"Dataset {self.name}", facts, columns, rows, len(self))

    def episodes(self, ids: Iterable[str] | None = None) -> Iterator[Episode]:
        """Yield episodes in the order of `ids`, by default all in the order of `self.ids`.

        Every episode's content hash is checked on the way.

        Raises
        ------
        UnknownNameError
            When an id is not in this version.
        DataError
            When a part is damaged; names the file.
        """
        names = self.ids if ids is None else tuple(ids)
        places = [self._place(name) for name in names]
        rows = lru_cache(maxsize=_GROUPS_HELD)(RawPart.rows)
        read_group = lru_cache(maxsize=_GROUPS_HELD)(lambda part, number: part.group(number, rows(part)))
        return (
            _episode(read_group(place.part, place.group), place, name)
            for name, place in zip(names, places, strict=True)
        )

    def episode(self, id: str) -> Episode:
        """Return one episode.

        Raises
        ------
        UnknownNameError
            When the id is not in this version.
        DataError
            When its part is damaged; names the file.
        """
        return next(self.episodes([id]))

    def contents(self, ids: Iterable[str]) -> Iterator[tuple[str, str]]:
        """Yield id and content hash of episodes as they lie there now, whatever manifests claim; by part, not by id.

        Raises
        ------
        UnknownNameError
            When an id is not in this version.
        DataError
            When a part does not decode, or another episode lies in the place of one; names the file.
        """
        groups: dict[str, dict[int, list[str]]] = {}
        for name in sorted(ids, key=lambda name: self._place(name).position):
            place = self.places[name]
            groups.setdefault(place.part.entry.id, {}).setdefault(place.group, []).append(name)
        for by_group in groups.values():
            rows = None
            for number, names in by_group.items():
                part = self.places[names[0]].part
                rows = part.rows() if rows is None else rows
                group = part.group(number, rows)
                yield from ((name, _raw(group, self.places[name], name).content_hash()) for name in names)

    def _place(self, name: str) -> EpisodePlace:
        """Return the place of an episode."""
        if name not in self.places:
            raise UnknownNameError("episode", name, self.ids, Where(path=str(self.path)))
        return self.places[name]

    def raw_parts(self) -> Iterator[RawPart]:
        """Yield the parts as they lie on the disk, for what must look at data that may be damaged."""
        return (RawPart(self.path, entry) for entry in self.file.parts)

    def catalog(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return one row an episode, in the order of `ids`: who, what, when, rows, content hash, part.

        Read from `catalog/<digest>.parquet`, which is made on the first call where the folder can be written,
        and made again where it is damaged or tells of other parts.

        Parameters
        ----------
        columns : sequence of str, optional
            Columns to read, by default all; of 100,000 episodes a few are read in a tenth of the time.

        Raises
        ------
        UnknownNameError
            When there is no such column.
        DataError
            When a part is damaged; names the file.
        """
        known_columns = (*encode.EPISODE_COLUMNS.names, "part")
        for name in columns or ():
            if name not in known_columns:
                raise UnknownNameError("column of the catalog", name, known_columns, Where(path=str(self.path)))
        path = catalog_path(self.path, self.digest)
        try:
            if (pq.read_schema(path).metadata or {}).get(_MADE_FROM) == self._parts_key():
                return read_parquet(path, columns).replace_schema_metadata(None)
        except (pa.ArrowException, OSError, DataError):
            pass  # made from the parts, so it can be made again
        table = self._build_catalog()
        _keep(self.path, path, table.replace_schema_metadata({_MADE_FROM: self._parts_key()}))
        return table if columns is None else table.select(list(columns))

    def _parts_key(self) -> bytes:
        """Return a hash of the parts and exclusions of this version: equal content may lie in other parts."""
        facts = [*(entry.sha256 for entry in self.file.parts), "", *sorted(self.file.exclusions)]
        return hashlib.sha256("\n".join(facts).encode()).hexdigest().encode()

    def _build_catalog(self) -> pa.Table:
        """Return the catalog from the tables of the parts."""
        tables = [_NO_ROWS]
        for part in self.raw_parts():
            rows = part.table()
            tables.append(rows.append_column("part", pa.array([part.entry.id] * len(rows), pa.string())))
        table = pa.concat_tables(tables)
        is_current = [
            self.places[i].part.entry.id == p if i in self.places else False
            for i, p in zip(table["id"].to_pylist(), table["part"].to_pylist(), strict=True)
        ]
        table = table.filter(pa.array(is_current, pa.bool_()))
        return table.take(pc.sort_indices(table, [("id", "ascending")])).combine_chunks()


_NO_ROWS = encode.EPISODE_COLUMNS.append(pa.field("part", pa.string())).empty_table()

#: Key of the catalog's schema metadata that tells what it was made from.
_MADE_FROM = b"candata.made_from"


def catalog_path(root: Path, digest: str) -> Path:
    """Return the file of the catalog of a version."""
    return root / "catalog" / f"{digest}.parquet"


def _keep(root: Path, path: Path, table: pa.Table) -> None:
    """Store a table that can be made again; a folder that cannot be written is no error."""
    try:
        with durable.replacing_staged(root, path) as draft:
            pq.write_table(table, draft, compression="zstd")
    except (OSError, SetupError):
        return


def _raw(group: list[RawEpisode], place: EpisodePlace, name: str) -> RawEpisode:
    """Return an episode of a row group as it lies there, with its dense channels."""
    offset = place.position % EPISODES_PER_ROW_GROUP
    if offset >= len(group) or group[offset].id != name:
        raise durable.damaged_error(place.part.folder / STEPS, f"another episode at position {place.position}", name)
    return place.part.with_dense(group[offset])


def _episode(group: list[RawEpisode], place: EpisodePlace, name: str) -> Episode:
    """Return the episode, checked against the hash its part was published with."""
    raw = _raw(group, place, name)
    digest = raw.content_hash()
    if digest != place.content_hash:
        raise changed_error(place, name, digest)
    return Episode(raw.meta(), raw.arrays)


def changed_error(place: EpisodePlace, name: str, digest: str) -> DataError:
    """Return the error for an episode whose content is not what its part was published with."""
    return DataError(
        "damaged dataset: the content of an episode has changed",
        expected=f"content {place.content_hash[:12]}",
        found=f"content {digest[:12]}",
        where=Where(path=str(place.part.folder / STEPS), episode=name),
        fix="restore the file from a copy; candata validate lists everything that is damaged",
    )


def open_dataset(path: str | Path, version: int | str | None = None, *, partial: bool = False) -> Dataset:
    """Return one version of a dataset, by default the newest.

    Parameters
    ----------
    path : str or Path
        Folder of the dataset.
    version : int or str, optional
        Number of the version, the start of its digest (6 characters or more), or a tag.
    partial : bool
        Leave out damaged parts instead of refusing; `raw_parts` still gives them. For the checks.

    Raises
    ------
    UsageError
        When there is no dataset or no such version.
    DataError
        When the dataset is empty, a part lacks a file or has one of the wrong size, or the version's digest is not that
        of its episodes; names the file.
    """
    root = Path(path)
    name = read_dataset_file(root).name
    file = find_version(root, version)
    places: dict[str, EpisodePlace] = {}
    excluded_ids, file_path, is_complete = frozenset(file.exclusions), version_path(root, file.number), True
    for part in (RawPart(root, entry) for entry in file.parts):
        try:
            pairs = _intact(part)
        except DataError:
            if not partial:
                raise
            is_complete = False
            continue
        for position, (episode, digest) in enumerate(pairs):
            earlier_place = places.setdefault(episode, EpisodePlace(part, position, digest))
            if earlier_place.content_hash != digest and not partial and episode not in excluded_ids:
                both_hashes = f"{earlier_place.content_hash[:12]} and {digest[:12]} of {episode}"
                raise durable.damaged_error(file_path, f"two contents: {both_hashes}", "one")
    for episode in excluded_ids:
        places.pop(episode, None)
    version_digest = (
        digest_of({episode: place.content_hash for episode, place in places.items()}) if is_complete else file.digest
    )
    if version_digest != file.digest:
        raise durable.damaged_error(
            file_path, f"digest {file.digest[:12]}", f"digest {version_digest[:12]} of its episodes"
        )
    return Dataset(root, name, file, places)


def _intact(part: RawPart) -> Iterable[tuple[str, str]]:
    """Return (episode id, content hash) of a part whose files stand in the right size."""
    manifest = part.manifest()
    problem = part.size_problem(manifest)
    if problem:
        raise problem
    return manifest.episodes
