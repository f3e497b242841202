"""LeRobot: reads v2.0, v2.1 and v3.0, writes v3.0 and v2.1; tables alone, videos are left out."""

from __future__ import annotations

from candata.formats import Format
from candata.formats._lerobot_read import read
from candata.formats._lerobot_write import write

FORMAT = Format(
    name="lerobot",
    summary="LeRobot folder, v2.1 or v3.0",
    read=read,
    takes_map=True,
    write=write,
    variants=("v21",),
)
