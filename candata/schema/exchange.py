"""Records of exchange with foreign formats: the map of an import, the sidecar of an export."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from candata.schema.episode import EpisodeMeta
from candata.schema.manifest import Lineage
from candata.schema.record import Record
from candata.schema.scene import Rate

#: Version of the sidecar; a reader refuses one it does not know.
SIDECAR_VERSION = 1
FiniteNumber = Annotated[float, Field(allow_inf_nan=False)]


class FeatureMap(Record):
    """`--map` for formats that hold named arrays (lerobot, robomimic, diffusion_policy).

    An entry of `channels` is one feature or a list of them, put side by side: `observation.state` is all of its
    columns, `observation.state[0:7]` or `[0:3, 6, 3:6]` some by number, `[elbow, wrist]` some by name. `units` is a
    unit a channel, or a list of one a column, where it is not SI; of lerobot also that of `timestamp`. `scales` is a
    number a channel, or a list of one a column, that makes the file's numbers ones of that unit, such as degrees a
    percent of a joint's range.
    """

    rate_hz: Rate | None = None
    scene: str | None = None
    object: str | None = None
    task: str | None = None
    channels: dict[str, str | tuple[str, ...]]
    units: dict[str, str | tuple[str, ...]] = {}
    scales: dict[str, FiniteNumber | tuple[FiniteNumber, ...]] = {}
    names: dict[str, tuple[str, ...]] = {}
    quaternion: Literal["wxyz", "xyzw"] = "wxyz"
    force: Literal["mean", "instant"] = "mean"
    action: Literal["next", "previous"] = "next"


class ExportedColumn(Record):
    """A channel (or `<channel>_valid`) of an export: the key it lies under, and what its numbers mean."""

    column: str
    key: str
    unit: str
    frame: str
    meaning: str


class ExportedEpisode(Record):
    """An episode of an export; `layout` is each column's shape without the time axis."""

    meta: EpisodeMeta
    rows: int
    content_hash: str
    layout: dict[str, tuple[int, ...]]


class ExportFile(Record):
    """What a foreign layout cannot hold: kept beside it, so that an import restores the episodes exactly.

    `clouds` are the point clouds that episodes name: `(N, 3)` little-endian float32 [m] in base64, by content hash.
    """

    format_version: int = SIDECAR_VERSION
    dataset: str
    digest: str
    lineage: tuple[Lineage, ...] = ()
    columns: tuple[ExportedColumn, ...]
    episodes: tuple[ExportedEpisode, ...] = ()
    clouds: dict[str, str] = {}
