"""Record of what was left out of a generated set, and why."""

from __future__ import annotations

from candata.errors import CandataError, DataError, Where
from candata.schema.record import Record


class QuarantinedEpisode(Record):
    """An episode that could not be made: its id, its motion and object, and the facts of the error it would raise."""

    id: str
    task: str
    object: str | None = None
    problem: str
    expected: str | None = None
    found: str | None = None
    path: str | None = None
    fix: str | None = None

    @classmethod
    def of(cls, episode_id: str, task: str, object_name: str | None, error: CandataError) -> QuarantinedEpisode:
        """Return the record of an error."""
        return cls(
            id=episode_id,
            task=task,
            object=object_name,
            problem=error.problem,
            expected=error.expected,
            found=error.found,
            path=error.where.path,
            fix=error.fix,
        )

    @property
    def error(self) -> DataError:
        """The error that the episode would raise."""
        where = Where(path=self.path, episode=self.id)
        return DataError(self.problem, expected=self.expected, found=self.found, where=where, fix=self.fix)


class QuarantineFile(Record):
    """`quarantine/NAME.json` of a dataset: episodes that one chunk of a generated set left out.

    `config` is the digest of the set's configuration, as in its lineage.
    """

    config: str
    episodes: tuple[QuarantinedEpisode, ...]
