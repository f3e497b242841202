"""Logs that are published one file a run, read from one Parquet table that was prepared from all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from candata.align import grid, on_rows, period_ns
from candata.errors import DataError, SetupError, Where
from candata.fetch import FetchedEpisodes
from candata.fetch._files import require_sha256
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Alignment, Episode

Columns = Mapping[str, NDArray]


@dataclass(frozen=True)
class PreparedTable:
    """A table that holds all runs of a published set.

    Attributes
    ----------
    file, sha256 : str
        Name of the table and its hash.
    origin : str
        Where the runs are published, with the revision.
    layout : str
        How the runs lie there, in words: what a download would have to read.
    episodes : callable
        `(columns) -> iterator of Episode`.
    licence_sha256 : str
        Of `LICENSE.txt` beside the table; empty where the repository has no such file.
    notice : str
        What stands for the licence's text where there is none.
    """

    file: str
    sha256: str
    origin: str
    layout: str
    episodes: Callable[[Columns], Iterator[Episode]]
    licence_sha256: str = ""
    notice: str = ""

    def from_folder(self, folder: Path) -> FetchedEpisodes:
        """Return the runs in a prepared folder, hashes checked.

        Raises
        ------
        DataError
            When a file is missing or is not the prepared one.
        """
        table, licence = Path(folder) / self.file, Path(folder) / "LICENSE.txt"
        notice = self.notice
        if self.licence_sha256:
            require_sha256(licence, self.licence_sha256, f"put the LICENSE of {self.origin} beside the table")
            notice = licence.read_text(encoding="utf-8")
        require_sha256(table, self.sha256, f"get the folder with {self.file} again")
        return FetchedEpisodes(self.episodes(_columns(table)), self.sha256, notice)

    def download(self, cache: Path, say: Callable[[str], None]) -> FetchedEpisodes:
        """Raise: the repository holds the runs in another layout, which is not read.

        Raises
        ------
        SetupError
            Always; says what is needed instead.
        """
        raise SetupError(
            "this set cannot be downloaded",
            expected=f"a folder with {self.file}",
            found=f"{self.origin} holds {self.layout}, which candata does not read",
            fix="read a prepared folder: --from FOLDER",
        )


def _columns(table: Path) -> dict[str, NDArray]:
    """Return the columns of a Parquet table.

    Raises
    ------
    DataError
        When it cannot be read.
    """
    try:
        content = pq.read_table(table)
    except (pa.ArrowException, OSError) as error:
        raise DataError("the table cannot be read", found=str(error), where=Where(path=str(table))) from None
    return {name: content[name].to_numpy(zero_copy_only=False) for name in content.column_names}


def runs(labels: NDArray) -> Iterator[NDArray[np.intp]]:
    """Yield the rows of each run, by first appearance of its label."""
    _, first_rows, run_of = np.unique(labels, return_index=True, return_inverse=True)
    for run in np.argsort(first_rows):
        yield np.flatnonzero(run_of == run)


def stamps_ns(time_s: NDArray) -> NDArray[np.int64]:
    """Return `(T,) int64 [ns]` stamps from seconds."""
    return np.rint(np.asarray(time_s, np.float64) * 1e9).astype(np.int64)


@dataclass(frozen=True)
class ResampledRun:
    """A run on even rows: arrays with their `_valid` flags, invalid rows by channel, and how it was put there."""

    arrays: dict[str, NDArray]
    invalid: dict[str, int]
    alignment: Alignment


def on_even_rows(
    time_ns: NDArray[np.int64],
    channels: Mapping[str, NDArray],
    rate_hz: float,
    max_gap_s: float,
    held: frozenset[str] = frozenset(),
) -> ResampledRun:
    """Return a run on the even rows of a rate, from its first stamp to its last, by `candata.align.on_rows`.

    Parameters
    ----------
    time_ns : (n,) int64 [ns]
        Recorded stamps, uneven.
    channels : mapping of str to ndarray
        Channel to its readings `(n, ...)`.
    rate_hz : float
        Rate of the rows.
    max_gap_s : float
        Stamps further apart are the ends of a gap [s].
    held : frozenset of str
        Channels that hold their value over a gap in the stamps, as a command does that nobody changed.
    """
    rows_ns = grid(int(time_ns[0]), int(time_ns[-1]), rate_hz)
    max_gap_periods = max_gap_s * 1e9 / period_ns(time_ns)
    arrays: dict[str, NDArray] = {"time_ns": rows_ns}
    invalid: dict[str, int] = {}
    for channel, values in channels.items():
        gap = np.inf if channel in held else max_gap_periods
        stream = on_rows(channel, time_ns, values, rows_ns, max_gap_periods=gap)
        arrays[channel] = stream.values
        if not stream.valid.all():
            arrays[channel + VALID_SUFFIX] = stream.valid
            invalid[channel] = int((~stream.valid).sum())
    return ResampledRun(arrays, invalid, Alignment(method=f"recorded stamps on even rows of {rate_hz:g} Hz, by role"))
