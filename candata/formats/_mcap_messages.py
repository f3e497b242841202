"""The protobuf messages of a log: `candata.*` built here in Python, joints as `foxglove.JointStates`.

Descriptors are built at run time, so that no generated file has to follow the protobuf release.
"""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

from candata.errors import MissingExtraError

#: Message to its fields in order: name, protobuf type, repeated. Units stand in the names or in `newton_per_count`.
_FIELDS: dict[str, tuple[tuple[str, str, bool], ...]] = {
    "WireBytes": (("data", "BYTES", False),),
    "FingertipForces": (("counts", "SINT32", True), ("newton_per_count", "DOUBLE", False)),
    "TactileFrame": (("counts", "BYTES", False), ("shape", "UINT32", True), ("newton_per_count", "DOUBLE", False)),
    "Values": (("values", "DOUBLE", True), ("shape", "UINT32", True)),
    "DeviceTime": (("time_ns", "INT64", False),),
    "MotorState": (("current_ampere", "DOUBLE", True), ("temperature_celsius", "DOUBLE", True)),
}


@cache
def message(name: str) -> Any:
    """Return the class of the message `name`: `candata.WireBytes`, ... or one of foxglove's.

    Raises
    ------
    MissingExtraError
        When protobuf or the foxglove schemas are not installed.
    """
    try:
        if name.startswith("foxglove."):
            kind = name.removeprefix("foxglove.")
            return getattr(importlib.import_module(f"foxglove_schemas_protobuf.{kind}_pb2"), kind)
        from google.protobuf import message_factory
    except ModuleNotFoundError as error:
        package = "foxglove-schemas-protobuf" if "foxglove" in str(error) else "protobuf"
        raise MissingExtraError(package, "record") from None
    return message_factory.GetMessageClass(_pool().FindMessageTypeByName(name))


def descriptors(name: str) -> bytes:
    """Return the serialised `FileDescriptorSet` of the message `name`: what an MCAP schema holds."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    files = FileDescriptorSet()
    seen_files: set[str] = set()

    def add(file: Any) -> None:
        if file.name not in seen_files:
            seen_files.add(file.name)
            for dependency in file.dependencies:
                add(dependency)
            file.CopyToProto(files.file.add())

    add(message(name).DESCRIPTOR.file)
    return files.SerializeToString()


@cache
def _pool() -> Any:
    """Return a pool of its own that holds the `candata.*` messages."""
    from google.protobuf import descriptor_pb2, descriptor_pool

    field_type = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="candata/log.proto", package="candata", syntax="proto3")
    for name, fields in _FIELDS.items():
        kind = file.message_type.add(name=name)
        for number, (field, type_name, is_repeated) in enumerate(fields, start=1):
            label = field_type.LABEL_REPEATED if is_repeated else field_type.LABEL_OPTIONAL
            kind.field.add(name=field, number=number, type=getattr(field_type, f"TYPE_{type_name}"), label=label)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return pool
