"""Diffusion Policy: a zarr group of format 2 with `data/*` and `meta/episode_ends`."""

from __future__ import annotations

from candata.formats import Format
from candata.formats._diffusion_policy_read import digest, read
from candata.formats._diffusion_policy_write import write

FORMAT = Format(
    name="diffusion_policy",
    summary="Diffusion Policy's zarr buffer",
    read=read,
    digest=digest,
    takes_map=True,
    write=write,
)
