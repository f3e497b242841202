"""What a generated set left out: one file a chunk under `quarantine/`, beside the versions, which never name it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from candata.datasets import durable
from candata.schema.quarantine import QuarantinedEpisode, QuarantineFile

QUARANTINE = "quarantine"


def write_quarantine(root: Path, config: str, episodes: Sequence[QuarantinedEpisode]) -> None:
    """Write which episodes a chunk left out; nothing where there are none.

    The file's name follows from the configuration and the first id, so that a chunk that is made again writes the same.

    Parameters
    ----------
    root : Path
        Dataset.
    config : str
        Digest of the set's configuration, as in its lineage.
    episodes : sequence of QuarantinedEpisode
        What was left out.
    """
    if not episodes:
        return
    folder = durable.ensure_below(root, root / QUARANTINE)
    record = QuarantineFile(config=config, episodes=tuple(episodes))
    with durable.replacing_staged(root, folder / f"{config[:12]}-{episodes[0].id}.json") as draft:
        draft.write_bytes(durable.encode_record(record))


def read_quarantine(root: Path, config: str | None = None) -> dict[str, QuarantinedEpisode]:
    """Return what was left out of a dataset by its id, in the order of ids; of one configuration where one is given.

    Raises
    ------
    DataError
        When a file is damaged; names it.
    """
    files = [durable.read_record(QuarantineFile, path) for path in sorted((root / QUARANTINE).glob("*.json"))]
    episodes = {e.id: e for file in files if config in (None, file.config) for e in file.episodes}
    return dict(sorted(episodes.items()))
