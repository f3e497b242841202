"""robomimic HDF5: one file, a group for each demonstration."""

from __future__ import annotations

from candata.formats import Format
from candata.formats._robomimic_read import read
from candata.formats._robomimic_write import write

FORMAT = Format(
    name="robomimic",
    summary="robomimic HDF5 file",
    read=read,
    takes_map=True,
    write=write,
)
