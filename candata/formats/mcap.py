"""MCAP recordings: ROS 2 bags (CDR) and Foxglove files (protobuf, JSON) by a map, and back for Foxglove.

A map says which topic becomes which channel; standard messages need no more than their topic:

    rate_hz: 100
    object: can
    channels:
      object_pose: {topic: /vicon/can/pose}
      joint_position: {topic: /joint_states, joints: [thumb_bend, index1]}
      action: {topic: /targets, joints: [thumb_bend, index1], clock: log}
      fingertip_force:
        - {topic: /tips/thumb/wrench, fingertips: [thumb]}
        - {topic: /tips/index/wrench, fingertips: [index], scale: -1}

Every stream is put on the rows by its role (`candata.align.on_rows`): states linear, commands held, forces the mean of
the step, nothing over a gap. What `candata export mcap` wrote needs no map: its episodes are restored bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from candata.errors import DataError, UsageError, Where
from candata.formats import Format, Reading
from candata.formats._map_file import read_map_file
from candata.formats._mcap_bag import Bag, Recording, metadata, read_bag, recordings
from candata.formats._mcap_episode import episodes
from candata.formats._mcap_own import EPISODE, restore
from candata.formats._mcap_streams import entries, require_topics, stream, topic_requests
from candata.formats._mcap_suggest import map_text, topics_text
from candata.formats._mcap_write import write
from candata.schema.episode import Episode
from candata.schema.topics import TopicMap


def read(source: Path, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes of a recording, a bag's folder, or a folder of several.

    Raises
    ------
    UsageError
        When there is no map and one is needed (its text holds one to start from), or the map is wrong.
    DataError
        When a file is damaged, a topic holds nothing, or (without gaps allowed) there is a gap.
    MissingExtraError
        When the package that decodes a topic is not installed.
    """
    mapping = _mapping(reading)
    all_recordings = recordings(Path(source))
    for recording in all_recordings:
        if mapping is None and _is_own(recording):
            yield restore(recording.files[0], reading)
        elif mapping is None:
            raise _no_map(recording)
        else:
            yield from _read(recording, mapping, reading)


def _is_own(recording: Recording) -> bool:
    """Tell whether candata wrote the recording."""
    return len(recording.files) == 1 and metadata(recording.files[0], EPISODE) is not None


def _mapping(reading: Reading) -> TopicMap | None:
    """Return the map, checked as far as it can be without the recording."""
    if reading.mapping is None:
        return None
    mapping = read_map_file(TopicMap, reading.mapping)
    entries(mapping, Where(path=str(reading.mapping)))
    return mapping


def _no_map(recording: Recording) -> UsageError:
    """Return the error of a missing map, with the recording's topics and a map to start from."""
    bag = read_bag(recording, samples=True)
    damage = "".join(f"\n# {line}" for line in bag.damage)
    return UsageError(
        "a map is needed that says which topic becomes which channel",
        expected="--map topics.yaml",
        found=f"{len(bag.topics)} topics\n{topics_text(bag)}",
        where=recording.where,
        fix=f"save this as topics.yaml, mend it, and give --map topics.yaml\n\n{map_text(bag)}{damage}".rstrip(),
    )


def _read(recording: Recording, mapping: TopicMap, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes of one recording under a map."""
    location = Where(path=str(reading.mapping))
    requests = topic_requests(mapping, location)
    channel_entries = entries(mapping, location)
    bag = read_bag(recording, requests)
    _refuse_damage(recording, bag, reading)
    require_topics([item.topic for item in requests], bag, recording.where)
    _tell_left_out(recording, bag, {item.topic for item in requests}, reading)
    streams = [
        stream(channel, entry, rows, mapping, recording, reading.allow_gaps, reading.note)
        for (channel, entry), rows in zip(channel_entries, bag.rows, strict=False)
    ]
    marks = bag.rows[-1] if len(bag.rows) > len(channel_entries) else []
    yield from episodes(recording, streams, marks, mapping, reading)


def _refuse_damage(recording: Recording, bag: Bag, reading: Reading) -> None:
    """Refuse damaged files; where gaps are allowed, what is lost is one, and is told."""
    if not bag.damage:
        return
    if not reading.allow_gaps:
        raise DataError(
            "the recording is damaged",
            expected="a whole MCAP file",
            found="; ".join(bag.damage),
            where=recording.where,
            fix="take another copy, or import with --allow-gaps: what can be read is kept, what is lost is a gap",
        )
    for line in bag.damage:
        reading.note(f"damaged: {line}; what can be read is imported")


def _tell_left_out(recording: Recording, bag: Bag, mapped_topics: set[str], reading: Reading) -> None:
    """Tell which topics the map leaves out."""
    unmapped_texts = [
        f"{name} ({topic.kind or 'no schema'}, {f'{topic.count} messages' if topic.count else 'empty'})"
        for name, topic in sorted(bag.topics.items())
        if name not in mapped_topics
    ]
    if unmapped_texts:
        reading.note(f"{recording.name}: left out, not in the map: {', '.join(unmapped_texts)}")


FORMAT = Format(
    name="mcap",
    summary="MCAP: ROS 2 bags and Foxglove recordings by a topics.yaml; export for Foxglove",
    read=read,
    takes_map=True,
    write=write,
)
