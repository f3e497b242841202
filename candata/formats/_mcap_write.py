"""Episodes as MCAP files for Foxglove: transforms, joints, forces as arrows, the cloud, and candata's own rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from candata.errors import SetupError, Where
from candata.formats import Writing
from candata.formats._mcap_messages import descriptors, message
from candata.formats._mcap_own import EPISODE, POINTS, ROWS, TAXELS, episode_record, row_schema, rows_json
from candata.schema.episode import Episode

TRANSFORMS, JOINTS, TARGETS, FORCES = "/tf", "/joint_states", "/joint_targets", "/fingertip_forces"
_TYPES = {
    TRANSFORMS: "foxglove.FrameTransforms",
    JOINTS: "foxglove.JointStates",
    TARGETS: "foxglove.JointStates",
    FORCES: "foxglove.SceneUpdate",
    POINTS: "foxglove.PointCloud",
    TAXELS: "candata.TactileFrame",
}
WORLD, OBJECT, HAND = "world", "object", "hand"
#: Length of an arrow, and its thickness.
METRE_PER_NEWTON, SHAFT_M = 0.02, 0.004
#: Letters of an episode's id in a file's name; its number keeps the names apart.
_NAME_LETTERS = 100

#: Makes a topic's message for row k; None if nothing is known.
_Say = Callable[[int, int], Any]


def write(episodes: Iterable[Episode], folder: Path, writing: Writing) -> None:
    """Write an MCAP file an episode, in the order of the episodes.

    Raises
    ------
    SetupError
        When the folder cannot be written.
    MissingExtraError
        When foxglove's schemas are not installed.
    """
    forces = False
    for number, episode in enumerate(episodes):
        path = folder / f"{number:06d}_{quote(episode.meta.id, safe='')[:_NAME_LETTERS]}.mcap"
        try:
            _write_episode(path, episode, writing)
        except OSError as error:
            raise SetupError("the file cannot be written", found=error.strerror, where=Where(path=str(path))) from None
        forces = forces or "fingertip_force" in episode
    if forces:
        writing.note(
            "forces are arrows in the frames fingertip/NAME; a dataset does not say where these are: place them with "
            "the hand's URDF, or plot /candata/row.fingertip_force"
        )


def _write_episode(path: Path, episode: Episode, writing: Writing) -> None:
    """Write one file."""
    from mcap.writer import Writer

    from candata import __version__

    says = _says(episode, writing)
    with path.open("xb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start("", library=f"candata {__version__}")
        writer.add_metadata(EPISODE, episode_record(episode))
        writer.add_metadata("candata.dataset", {"name": writing.name, "digest": writing.digest})
        channels = {topic: _channel(writer, topic) for topic in says}
        schema = writer.register_schema("candata.Row", "jsonschema", row_schema(episode))
        row_channel = writer.register_channel(ROWS, "json", schema)
        time_ns = episode["time_ns"]
        # MCAP knows no time before zero.
        stamps = (time_ns - min(0, int(time_ns[0]))).tolist()
        for k, (stamp, row) in enumerate(zip(stamps, rows_json(episode), strict=True)):
            for topic, say in says.items():
                payload = say(k, stamp)
                if payload is not None:
                    writer.add_message(channels[topic], stamp, payload.SerializeToString(), stamp, k)
            writer.add_message(row_channel, stamp, row, stamp, k)
        writer.finish()


def _channel(writer: Any, topic: str) -> int:
    """Return the channel of a topic, registered with its schema."""
    name = _TYPES[topic]
    return writer.register_channel(topic, "protobuf", writer.register_schema(name, "protobuf", descriptors(name)))


def _says(episode: Episode, writing: Writing) -> dict[str, _Say]:
    """Return by topic the function that makes the message of a row; only topics that the episode has data for."""
    says_by_topic: dict[str, _Say] = {}
    frames = {name: channel for name, channel in ((OBJECT, "object_pose"), (HAND, "hand_pose")) if channel in episode}
    if frames:
        says_by_topic[TRANSFORMS] = _transforms(episode, frames)
    if "joint_position" in episode:
        says_by_topic[JOINTS] = _joints(
            episode, episode.meta.joint_names, "joint_position", "joint_velocity", "joint_effort"
        )
    if "action" in episode:
        says_by_topic[TARGETS] = _joints(episode, episode.meta.actuator_names, "action")
    if "fingertip_force" in episode:
        says_by_topic[FORCES] = _arrows(episode)
    if "taxels" in episode and episode["taxels"].size:
        says_by_topic[TAXELS] = _taxels(episode)
    if episode.meta.point_cloud is not None and writing.cloud is not None:
        says_by_topic[POINTS] = _points(writing.cloud(episode.meta.point_cloud))
    return says_by_topic


def _transforms(episode: Episode, frames: dict[str, str]) -> _Say:
    """Return the function that makes the message of the poses of object and hand."""
    valid = {name: episode.valid(channel) for name, channel in frames.items()}
    poses = {name: episode[channel].astype(np.float64).tolist() for name, channel in frames.items()}

    def say(k: int, stamp: int) -> Any:
        packet = message(_TYPES[TRANSFORMS])()
        for name in frames:
            if valid[name][k]:
                x, y, z, qw, qx, qy, qz = poses[name][k]
                item = packet.transforms.add(parent_frame_id=WORLD, child_frame_id=name)
                item.timestamp.FromNanoseconds(stamp)
                item.translation.x, item.translation.y, item.translation.z = x, y, z
                item.rotation.w, item.rotation.x, item.rotation.y, item.rotation.z = qw, qx, qy, qz
        return packet if packet.transforms else None

    return say


def _joints(episode: Episode, names: tuple[str, ...], *channels: str) -> _Say:
    """Return the function that makes the message of the joints, or of the actuators' targets as positions."""
    fields = dict(zip(("position", "velocity", "effort"), channels, strict=False))
    channel_of = {field: channel for field, channel in fields.items() if channel in episode}
    valid = {field: episode.valid(channel) for field, channel in channel_of.items()}
    values = {field: episode[channel].astype(np.float64).tolist() for field, channel in channel_of.items()}
    labels = names or tuple(f"joint{k}" for k in range(episode[channels[0]].shape[1]))

    def say(k: int, stamp: int) -> Any:
        known_fields = [field for field in channel_of if valid[field][k]]
        if not known_fields:
            return None
        packet = message(_TYPES[JOINTS])()
        packet.timestamp.FromNanoseconds(stamp)
        for j, name in enumerate(labels):
            packet.joints.add(name=name, **{field: values[field][k][j] for field in known_fields})
        return packet

    return say


def _arrows(episode: Episode) -> _Say:
    """Return the function that makes the message of forces, an arrow in each fingertip's frame."""
    force = episode["fingertip_force"].astype(np.float64)
    valid, size = episode.valid("fingertip_force"), np.linalg.norm(force, axis=-1)
    turns = _axis_quaternions(force, size)
    labels = episode.meta.fingertip_names or tuple(f"f{k}" for k in range(force.shape[1]))

    def say(k: int, stamp: int) -> Any:
        if not valid[k]:
            return None
        packet = message(_TYPES[FORCES])()
        for f, name in enumerate(labels):
            entity = packet.entities.add(id=name, frame_id=f"fingertip/{name}")
            entity.timestamp.FromNanoseconds(stamp)
            if size[k, f] > 0:
                _draw(entity.arrows.add(), float(size[k, f]), turns[k, f].tolist())
        return packet

    return say


def _draw(arrow: Any, newton: float, turn: list[float]) -> None:
    """Shape an arrow: its length says the force."""
    length = METRE_PER_NEWTON * newton
    at = arrow.pose.orientation
    at.w, at.x, at.y, at.z = turn
    arrow.shaft_length, arrow.shaft_diameter = 0.8 * length, SHAFT_M
    arrow.head_length, arrow.head_diameter = 0.2 * length, 2 * SHAFT_M
    arrow.color.r, arrow.color.g, arrow.color.b, arrow.color.a = 0.85, 0.25, 0.1, 1.0


def _axis_quaternions(vectors: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternions w x y z that turn the x axis into the vectors; identity for those without length.

    For an angle a about n, (1 + cos a, n sin a) is 2 cos(a/2) times (cos(a/2), n sin(a/2)); the first is
    (1 + x . u, x cross u).
    """
    unit = np.divide(vectors, size[..., None], out=np.zeros_like(vectors), where=size[..., None] > 0)
    unit[size == 0, 0] = 1.0
    turn = np.stack([1 + unit[..., 0], np.zeros_like(size), -unit[..., 2], unit[..., 1]], axis=-1)
    turn[unit[..., 0] < -1 + 1e-9] = (0.0, 0.0, 0.0, 1.0)
    return turn / np.linalg.norm(turn, axis=-1, keepdims=True)


def _taxels(episode: Episode) -> _Say:
    """Return the function that makes the message of the raw counts."""
    counts, scale = episode["taxels"].astype("<i2"), episode.meta.newton_per_count or 0.0
    shape = counts.shape[1:]

    def say(k: int, stamp: int) -> Any:
        return message(_TYPES[TAXELS])(counts=counts[k].tobytes(), shape=shape, newton_per_count=scale)

    return say


def _points(points: NDArray) -> _Say:
    """Return the function that makes the message of the object's cloud, once, in its frame."""
    data = np.ascontiguousarray(points, "<f4").tobytes()

    def say(k: int, stamp: int) -> Any:
        if k:
            return None
        packet = message(_TYPES[POINTS])(frame_id=OBJECT, point_stride=12, data=data)
        packet.timestamp.FromNanoseconds(stamp)
        packet.pose.orientation.w = 1.0
        number = message("foxglove.PackedElementField").NumericType.Value("FLOAT32")
        for i, axis in enumerate("xyz"):
            packet.fields.add(name=axis, offset=4 * i, type=number)
        return packet

    return say
