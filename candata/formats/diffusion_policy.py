"""Diffusion Policy: a zarr group with `data/*` and `meta/episode_ends`, read in format 2 or 3, written in 2."""

from __future__ import annotations

from candata.formats import Format
from candata.formats._diffusion_policy_read import read
from candata.formats._diffusion_policy_write import write

FORMAT = Format(
    name="diffusion_policy",
    summary="Diffusion Policy's zarr buffer, or its .zarr.zip",
    read=read,
    takes_map=True,
    write=write,
)
