"""Adding episodes: parts written as they come, one version at the end."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from candata.datasets import encode
from candata.datasets.parts import write_part
from candata.datasets.versions import index_of, is_new_episode, newest_version, publish, read_dataset_file
from candata.errors import UsageError
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage, VersionFile


def append(path: str | Path, episodes: Iterable[Episode], lineage: Lineage, part_size: int = 16) -> VersionFile:
    """Return the version with the dataset's episodes and `episodes`; the current one if they add nothing.

    An episode that stands with the same content is skipped. Episodes are taken one by one; at most
    `part_size` are held. A failure on the way publishes nothing.

    Parameters
    ----------
    path : str or Path
        Dataset, made by `create_dataset`.
    episodes : iterable of Episode
        Episodes to add; they may differ in their channels.
    lineage : Lineage
        How they came to be; its operation is kept as the parts' producer.
    part_size : int
        Episodes a part.

    Raises
    ------
    DataError
        When an id stands, or comes twice, with different content.
    UsageError
        When there is no dataset, or nothing at all to publish.
    """
    return publish(path, write_parts(path, episodes, lineage.operation, part_size), lineage)


def write_parts(path: str | Path, episodes: Iterable[Episode], operation: str, part_size: int = 16) -> list[str]:
    """Return the ids of the parts that hold what `episodes` add; they belong to no version until published.

    For a lineage that is known only once all episodes are; else `append` does both.

    Parameters
    ----------
    path : str or Path
        Dataset.
    episodes : iterable of Episode
        As for `append`.
    operation : str
        How they came to be: kept as the parts' producer.
    part_size : int
        Episodes a part.

    Raises
    ------
    DataError
        When an id stands, or comes twice, with different content.
    UsageError
        When there is no dataset.
    """
    root = Path(path)
    read_dataset_file(root)
    if part_size < 1:
        raise UsageError("part_size is too small", expected="at least 1", found=str(part_size))
    current = newest_version(root)
    known_hashes = index_of(root, current.parts) if current else {}
    batches = _batches(_new_episodes(root, episodes, known_hashes), part_size)
    return [write_part(root, batch, {"operation": operation}).id for batch in batches]


def _new_episodes(root: Path, episodes: Iterable[Episode], known_hashes: dict[str, str]) -> Iterator[Episode]:
    """Yield the episodes that are not in `known_hashes`, which grows with them."""
    for episode in episodes:
        digest, name = encode.content_hash(episode), episode.meta.id
        if is_new_episode(root, known_hashes, name, digest):
            known_hashes[name] = digest
            yield episode


def _batches(episodes: Iterable[Episode], size: int) -> Iterator[list[Episode]]:
    """Yield lists of episodes with equal channels; at most `size` episodes are held in all."""
    episodes_by_layout: dict[tuple, list[Episode]] = {}
    for episode in episodes:
        episodes_by_layout.setdefault(tuple(encode.layout_of(episode).items()), []).append(episode)
        if sum(map(len, episodes_by_layout.values())) == size:
            yield episodes_by_layout.pop(max(episodes_by_layout, key=lambda layout: len(episodes_by_layout[layout])))
    yield from episodes_by_layout.values()
