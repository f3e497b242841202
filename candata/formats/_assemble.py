"""From blocks of numbers to a checked episode: gaps, flags, contact. Shared by the formats."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.contact import fingertip_contact
from candata.schema.episode import ContactRule, Episode, EpisodeMeta

#: Largest number the schema's float32 holds; beyond it are only the fill values of other formats.
LARGEST_NUMBER = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Block:
    """The values of one channel as a file has them.

    Attributes
    ----------
    channel : str
        Name of the channel.
    values : ndarray
        `(T, n) float64`, in SI; NaN is a gap.
    columns : tuple of str
        What the n columns are called in the file, for messages.
    shape : tuple of int
        Shape of one row of the channel.
    """

    channel: str
    values: NDArray[np.float64]
    columns: tuple[str, ...]
    shape: tuple[int, ...]


@dataclass(frozen=True)
class EpisodeArrays:
    """Arrays of an episode, what its contact flags came from, and the number of invalid rows by channel."""

    arrays: dict[str, NDArray]
    rule: ContactRule | None
    invalid: dict[str, int]


def gather(
    time_ns: NDArray[np.int64], blocks: Iterable[Block], rows: NDArray[np.intp], location: Where, allow_gaps: bool
) -> EpisodeArrays:
    """Return the arrays of an episode: gaps marked, flags as bool, missing contact channels derived.

    Parameters
    ----------
    time_ns : ndarray
        `(T,) int64 [ns]`.
    blocks : iterable of Block
        The channels.
    rows : ndarray
        `(T,)` numbers of the rows in the file, for messages.
    location : Where
        File and episode, for messages.
    allow_gaps : bool
        Mark values that are not finite as invalid instead of refusing them.

    Raises
    ------
    DataError
        When a value is not finite, or a flag is neither 0 nor 1.
    """
    arrays: dict[str, NDArray] = {"time_ns": time_ns}
    invalid: dict[str, int] = {}
    for block in blocks:
        channel_location = dataclasses.replace(location, channel=block.channel)
        values = block.values
        gaps = ~(np.abs(values) <= LARGEST_NUMBER)
        if gaps.any():
            if not allow_gaps:
                raise _gap_error(block, gaps, rows, channel_location)
            values = np.where(gaps, np.nan, values)
            arrays[block.channel + VALID_SUFFIX] = np.asarray(~gaps.any(axis=1))
            invalid[block.channel] = int(gaps.any(axis=1).sum())
        arrays[block.channel] = _typed(block.channel, values, channel_location).reshape(len(rows), *block.shape)
    return EpisodeArrays(arrays, derive_contact(arrays, invalid), invalid)


def checked_episode(meta: EpisodeMeta, arrays: Mapping[str, NDArray], path: object) -> Episode:
    """Return the episode; what is wrong with it is said with the file's name.

    Raises
    ------
    DataError
        What `Episode` raises, with `path` in its place.
    """
    try:
        return Episode(meta, arrays)
    except DataError as error:
        location = dataclasses.replace(error.where, path=str(path))
        facts = {"expected": error.expected, "found": error.found, "fix": error.fix}
        raise DataError(error.problem, where=location, **facts) from None


def _gap_error(block: Block, gaps: NDArray, rows: NDArray, location: Where) -> DataError:
    """Return the error of a channel that holds values which are not finite."""
    row, column = (int(i) for i in np.argwhere(gaps)[0])
    return DataError(
        f"{block.channel} is not finite",
        expected="finite numbers",
        found=f"a gap in column {block.columns[column]}, row {rows[row]} of the file "
        f"({int(gaps.any(axis=1).sum())} such rows in the episode)",
        where=dataclasses.replace(location, index=row),
        fix="import with --allow-gaps: such rows are kept and marked invalid",
    )


def _typed(channel: str, values: NDArray, location: Where) -> NDArray:
    """Return the values as the channel's kind; flags must be 0 or 1 (a gap is False)."""
    if CHANNELS[channel].dtype != "bool":
        return values
    misfits = np.argwhere(np.isfinite(values) & (values != 0) & (values != 1))
    if len(misfits):
        row, column = (int(i) for i in misfits[0])
        raise DataError(
            f"{channel} is no flag",
            expected="0 or 1",
            found=f"{values[row, column]:g}",
            where=dataclasses.replace(location, index=row),
        )
    return values == 1


def derive_contact(arrays: dict[str, NDArray], invalid: dict[str, int]) -> ContactRule | None:
    """Add the contact channels that are missing; return the rule if a threshold was applied.

    Parameters
    ----------
    arrays : dict of str to ndarray
        Channels and their `_valid` flags; added to.
    invalid : dict of str to int
        Invalid rows by channel; added to.
    """
    rule = None
    if "fingertip_force" in arrays and "fingertip_contact" not in arrays:
        rule = ContactRule()
        arrays["fingertip_contact"] = fingertip_contact(arrays["fingertip_force"], rule.threshold_n)
        _inherit(arrays, invalid, "fingertip_force", "fingertip_contact")
    if "fingertip_contact" in arrays and "contact" not in arrays:
        arrays["contact"] = np.asarray(arrays["fingertip_contact"].any(axis=1))
        _inherit(arrays, invalid, "fingertip_contact", "contact")
    return rule


def _inherit(arrays: dict[str, NDArray], invalid: dict[str, int], origin: str, derived_channel: str) -> None:
    """Mark a derived channel invalid where the one it comes from is."""
    if origin in invalid:
        arrays[derived_channel + VALID_SUFFIX] = arrays[origin + VALID_SUFFIX]
        invalid[derived_channel] = invalid[origin]
