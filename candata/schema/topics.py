"""Records of the map files of recordings: `topics.yaml` (MCAP) and `frames.yaml` (FoundationPose)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from candata.schema.record import Record
from candata.schema.scene import Rate

#: `header`: the stamp in the message. `log`: when it was recorded. `publish`: when it was sent. `fitted`: the stamp in
#: the message, moved onto the recorder's clock by a straight line through both.
Clock = Literal["header", "log", "publish", "fitted"]
StreamRole = Literal["state", "command", "measurement", "sample", "flag"]


class TopicEntry(Record):
    """One topic that becomes (a part of) a channel.

    `fields` are paths in the message, such as `pose.position.x`, `data` or `data[0:6]`; standard messages need none,
    and poses are in the order x y z, w x y z. `joints` are matched by the message's own names where it has some, else
    they name its values in order; `fingertips` name those of forces and contact. `child` and `parent` pick the frame of
    a transform. `scale` multiplies the values (-1 turns a force round). `max_gap_periods`: readings further apart, in
    median intervals of the topic, are the ends of a gap; `.inf` for what is sent on change alone.
    """

    topic: str
    fields: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    fingertips: tuple[str, ...] = ()
    child: str | None = None
    parent: str | None = None
    unit: str | None = None
    scale: float = 1.0
    clock: Clock | None = None
    role: StreamRole | None = None
    max_gap_periods: Annotated[float, Field(gt=0, allow_inf_nan=True)] = 1.5


def _form(value: object) -> str:
    """Return which of its forms a channel's value in a map has, so that an error names the field in that."""
    if isinstance(value, str):
        return "topic"
    return "entries" if isinstance(value, list | tuple) else "entry"


_Topic = Annotated[str, Tag("topic")]
_Entry = Annotated[TopicEntry, Tag("entry")]
Entries = tuple[Annotated[_Topic | _Entry, Discriminator(_form)], ...]


class Cuts(Record):
    """Where the episodes of a recording begin and end; seconds count from the first reading of a mapped topic.

    With a marker, a flag that turns true begins an episode and one that turns false ends it: `field` of its messages,
    or a `std_msgs/Bool`. A message without a flag ends the last episode and begins the next.
    """

    ranges_s: tuple[tuple[float, float], ...] = ()
    marker: str | None = None
    field: str | None = None
    clock: Clock = "log"


class TopicMap(Record):
    """`topics.yaml`: which topic of a recording becomes which channel.

    `reference` is a channel whose own stamps are the rows; without it the rows are `rate_hz` apart. A channel is a
    topic, an entry, or a list of entries whose values stand side by side.
    """

    rate_hz: Rate
    channels: dict[str, Annotated[_Topic | _Entry | Annotated[Entries, Tag("entries")], Discriminator(_form)]] = Field(
        min_length=1
    )
    clock: Clock = "header"
    reference: str | None = None
    episodes: Cuts | None = None
    source: Literal["real", "sim"] | None = None
    scene: str | None = None
    object: str | None = None
    task: str | None = None
    force: Literal["mean", "instant"] = "mean"
    action: Literal["next", "previous"] = "next"


Row4 = tuple[float, float, float, float]


class FramesMap(Record):
    """`frames.yaml`: what a folder of FoundationPose results does not say of itself.

    Frames are `rate_hz` apart; with `stamps` their file names are times in that unit instead. `camera_pose` is camera
    to world, 4 x 4 by rows; without it poses stay in the camera's frame.
    """

    rate_hz: Rate
    camera_pose: Annotated[tuple[Row4, ...], Field(min_length=4, max_length=4)] | None = None
    stamps: Literal["s", "ms", "us", "ns"] | None = None
    source: Literal["real", "sim"] | None = None
    scene: str | None = None
    object: str | None = None
    task: str | None = None
