"""Messages of an MCAP file as values with fields: CDR of ROS 2, protobuf and JSON, by the schemas in the file."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from typing import Any

from candata.errors import DataError, MissingExtraError, Where

Decode = Callable[[bytes], Any]


def type_name(name: str) -> str:
    """Return a type's plain name: `geometry_msgs/msg/Pose` -> `geometry_msgs/Pose`; `foxglove_msgs` as foxglove."""
    short_name = name.replace("/msg/", "/")
    return (
        "foxglove." + short_name.removeprefix("foxglove_msgs/")
        if short_name.startswith("foxglove_msgs/")
        else short_name
    )


def decoder(topic: str, encoding: str, schema: Any, location: Where) -> Decode:
    """Return the function that decodes the messages of a topic.

    Parameters
    ----------
    topic, encoding : str
        Topic and encoding of its messages.
    schema : mcap.records.Schema or None
        What the file says of their layout.
    location : Where
        The file.

    Raises
    ------
    DataError
        When the encoding is none of the three, or the schema is damaged.
    MissingExtraError
        When the package that decodes it is not installed.
    """
    kind = (encoding, schema.encoding if schema is not None else "")
    if encoding == "json":
        return json.loads
    if kind not in _BY_SCHEMA:
        raise DataError(
            f"the messages of {topic} are in an encoding that is not read",
            expected="cdr with ros2msg, protobuf, or json",
            found=" with ".join(part or "no schema" for part in kind),
            where=location,
            fix="leave the topic out of the map, or convert the recording",
        )
    try:
        return _BY_SCHEMA[kind](schema)
    except MissingExtraError:
        raise
    except Exception as error:  # parsers of schemas raise what they like
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise DataError(f"the schema of {topic} cannot be read", found=reason, where=location) from None


def _ros2(schema: Any) -> Decode:
    """Return the decoder of a ROS 2 message definition."""
    try:
        from mcap_ros2.decoder import DecoderFactory
    except ModuleNotFoundError:
        raise MissingExtraError("mcap-ros2-support", "formats") from None
    with contextlib.redirect_stderr(io.StringIO()):  # its parser prints what it then raises
        decode = DecoderFactory().decoder_for("cdr", schema)
    if decode is None:
        raise ValueError("no decoder")
    return decode


def _protobuf(schema: Any) -> Decode:
    """Return the decoder of a protobuf `FileDescriptorSet`."""
    try:
        from google.protobuf import descriptor_pool, message_factory
        from google.protobuf.descriptor_pb2 import FileDescriptorSet
    except ModuleNotFoundError:
        raise MissingExtraError("protobuf", "record") from None
    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString


_BY_SCHEMA: dict[tuple[str, str], Callable[[Any], Decode]] = {
    ("cdr", "ros2msg"): _ros2,
    ("protobuf", "protobuf"): _protobuf,
}


def decode_message(decode: Decode, data: bytes, topic: str, index: int, location: Where) -> Any:
    """Return a message.

    Raises
    ------
    DataError
        When the bytes are no such message; names the topic and which of its messages it is.
    """
    try:
        return decode(data)
    except Exception as error:  # decoders raise what they like
        raise DataError(
            f"message {index} of {topic} cannot be decoded",
            found=f"{type(error).__name__}: {error}".splitlines()[0],
            where=Where(path=location.path, index=index),
            fix="the file is damaged there: take another copy, or leave the topic out of the map",
        ) from None
