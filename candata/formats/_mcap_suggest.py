"""The content of a recording as text: a table of its topics, and a map that can be saved and mended."""

from __future__ import annotations

import yaml

from candata.formats._mcap_bag import Bag, Topic
from candata.formats._mcap_fields import (
    JOINTS,
    TRANSFORMS,
    child_frame,
    default_channels,
    joint_names,
    stamp_ns,
    transforms,
)

#: Words in a topic's name that tell what it carries.
_COMMAND, _HAND = ("command", "target", "cmd", "setpoint"), ("hand", "wrist", "palm", "gripper", "tool", "ee_")


def topics_text(bag: Bag) -> str:
    """Return a line a topic: name, type, messages, rate, stamps."""
    lines = []
    for name, topic in sorted(bag.topics.items()):
        rate = f"{topic.rate_hz:.1f} Hz" if topic.rate_hz else "-"
        stamps = "" if not topic.count else ", stamped" if _has_stamp(topic) else ", unstamped"
        lines.append(f"{name}  {topic.kind or '(no schema)'}  {topic.count} messages  {rate}{stamps}")
    return "\n".join(lines) or "no topics"


def map_text(bag: Bag) -> str:
    """Return a suggested `topics.yaml`: each channel from the first topic that can be it."""
    channels: dict[str, object] = {}
    rates = []
    unused_topics = []
    for name, topic in sorted(bag.topics.items(), key=lambda item: (not _has_stamp(item[1]), item[0])):
        channel = _channel(name, topic, channels)
        if channel is None:
            unused_topics.append(name)
            continue
        channels[channel] = _entry(name, topic)
        rates.append(topic.rate_hz)
    if not channels:
        channels = {"object_pose": {"topic": "/pose", "fields": [f"pose.position.{axis}" for axis in "xyz"]}}
    value = {"rate_hz": float(round(max(rates, default=0.0)) or 100), "object": "NAME", "channels": channels}
    text = yaml.safe_dump(value, sort_keys=False, default_flow_style=None, width=110)
    return text + (f"# not used: {', '.join(sorted(unused_topics))}\n" if unused_topics else "")


def _has_stamp(topic: Topic) -> bool:
    """Tell whether a topic's first message bears a stamp."""
    if topic.sample is None:
        return False
    if topic.kind in TRANSFORMS:
        return any(stamp_ns(item) > 0 for item in transforms(topic.sample, topic.kind)[:1])
    return stamp_ns(topic.sample) > 0


def _channel(name: str, topic: Topic, used_channels: dict[str, object]) -> str | None:
    """Return the channel that a topic could be, none where all such are taken."""
    if topic.count < 2:
        return None
    could = [channel for channel in default_channels(topic.kind) if channel not in used_channels]
    words = name.lower()
    if any(word in words for word in _COMMAND):
        could = [channel for channel in could if channel == "action"]
    elif "hand_pose" in could:
        pose_channel = "hand_pose" if any(word in words for word in _HAND) else "object_pose"
        could = [channel for channel in could if channel == pose_channel]
    elif topic.kind in JOINTS:
        could = [channel for channel in could if channel == "joint_position"]
    return could[0] if could else None


def _entry(name: str, topic: Topic) -> dict[str, object]:
    """Return the map's entry of a topic."""
    entry: dict[str, object] = {"topic": name}
    if topic.kind in JOINTS and topic.sample is not None:
        entry["joints"] = list(joint_names(topic.sample))
    if topic.kind in TRANSFORMS or topic.kind == "foxglove.FrameTransform":
        frames = transforms(topic.sample, topic.kind) if topic.sample is not None else []
        entry["child"] = child_frame(frames[0]) if frames else "NAME"
    if not _has_stamp(topic):
        entry["clock"] = "log"
    return entry
