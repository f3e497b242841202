"""A check that values fit into memory: a header may claim more than any machine holds."""

from __future__ import annotations

import os

from candata.errors import DataError, Where

#: Times that the values of an episode are held while they are read: as they lie in the file, as float64 in SI, and as
#: the channel that is checked.
_COPIES = 3


def largest_bytes() -> int:
    """Return how much may be read at once on this machine [bytes]."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // _COPIES


def require_memory(size_bytes: int, label: str, location: Where) -> None:
    """Raise where values are too many to be held while they are read; nothing is allocated.

    Parameters
    ----------
    size_bytes : int
        Their size [bytes].
    label : str
        What claims that size, for the message.
    location : Where
        Place, for the message.

    Raises
    ------
    DataError
        Says how large they are, and how large the memory is.
    """
    if size_bytes > largest_bytes():
        raise DataError(
            f"{label} does not fit into memory",
            expected=f"at most {largest_bytes() / 1e9:.3g} GB, a third of this machine's memory",
            found=f"{size_bytes / 1e9:,.4g} GB",
            where=location,
            fix="a header that claims more than was recorded is damaged; else cut the recording into shorter episodes",
        )
