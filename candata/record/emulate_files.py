"""Files of an emulation: the table of what the wire does not carry, its map, and the truth for tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from numpy.typing import NDArray

from candata.datasets.writing import replacing, write_text
from candata.errors import SetupError, UsageError, Where
from candata.record.emulate import Transmission
from candata.record.emulate_script import Script
from candata.schema.scene import TableMap

MAP = "map.yaml"
#: Key of the table's metadata that holds the episode's meta as JSON.
META_KEY = b"candata.episode"
_POSE = ("px", "py", "pz", "qw", "qx", "qy", "qz")


def check_table(path: Path, script: Script) -> None:
    """Refuse a place for the table before anything is sent.

    Raises
    ------
    UsageError
        When it is no Parquet file, it or the map beside it stands, or the wire carries all there is.
    SetupError
        When its folder cannot be made.
    """
    if path.suffix != ".parquet":
        raise UsageError("the table is a Parquet file", expected="a name that ends in .parquet", found=path.name)
    if not {"joint_position", "object_pose"} & set(script.unwired_channels):
        raise UsageError("the wire carries all of this episode", fix="leave out --with-table")
    prepare(path)
    prepare(path.with_name(MAP))


def prepare(path: Path) -> None:
    """Refuse a file that stands, and make its folder.

    Raises
    ------
    UsageError
        When it does.
    SetupError
        When the folder cannot be made.
    """
    if path.exists():
        raise UsageError("the output exists already", where=Where(path=str(path)), fix="choose another place")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SetupError("the file cannot be written", found=error.strerror, where=Where(path=str(path))) from None


def write_table(path: Path, transmission: Transmission) -> None:
    """Write the table, a row for each reply with its time, and `map.yaml` beside it for `candata import table`.

    Raises
    ------
    SetupError
        When a file cannot be written.
    """
    script = transmission.script
    channel_columns = _columns(script)
    table = {"t": transmission.state_time_ns * 1e-9}
    for channel, columns in channel_columns.items():
        block = script.unwired_channels[channel][transmission.index]
        table |= {column: block[:, k] for k, column in enumerate(columns)}
    meta = script.meta
    mapping = TableMap(
        file=path.name,
        source=meta.source,
        time_s="t",
        rate_hz=script.rate_hz,
        scene=meta.scene,
        object=meta.object,
        task=meta.task,
        channels=dict(channel_columns),
        force=meta.force,
    )
    text = yaml.safe_dump(mapping.model_dump(mode="json", exclude_none=True, exclude={"units"}), sort_keys=False)
    columns = pa.table(table).replace_schema_metadata({META_KEY: meta.model_dump_json().encode()})
    with replacing(path, "table") as draft:
        pq.write_table(columns, draft)
    write_text(path.with_name(MAP), text, "map")


def _columns(script: Script) -> dict[str, tuple[str, ...]]:
    """Return the columns of each channel that the wire does not carry."""
    channel_columns = {
        "object_pose": _POSE,
        "joint_position": tuple(f"q_{name}" for name in script.unwired_joints),
        "action": tuple(f"a_{name}" for name in script.unwired_actuators),
    }
    return {channel: columns for channel, columns in channel_columns.items() if channel in script.unwired_channels}


def write_truth(path: Path, transmission: Transmission, streams: Mapping[str, NDArray] | None = None) -> None:
    """Write the values sent as npz: `command_time_ns`, `state_time_ns`, `*_whole`, joints, targets, forces, counts.

    Parameters
    ----------
    path : Path
        Where to.
    transmission : Transmission
        What the hand sent.
    streams : mapping, optional
        Arrays of what other devices sent.

    Raises
    ------
    SetupError
        When the file cannot be written.
    """
    script, index = transmission.script, transmission.index
    arrays = {
        "row": script.row[index],
        "still": index < script.rest_rows,
        "command_time_ns": transmission.command_time_ns,
        "state_time_ns": transmission.state_time_ns,
        "command_whole": transmission.command_whole,
        "state_whole": transmission.state_whole,
        "joint_position": script.joint_position[index],
        "joint_target": script.joint_target[index],
        "force": script.force[index],
        "force_counts": script.force_counts[index],
        "taxel_counts": script.taxel_counts[index],
        "newton_per_count": np.array(script.newton_per_count),
        "joint_names": np.array(script.device.joint_names),
        "fingertip_names": np.array(script.device.fingertip_names),
        "meta": np.array(script.meta.model_dump_json()),
    }
    arrays |= {f"unwired_{name}": block[index] for name, block in script.unwired_channels.items()}
    arrays |= streams or {}
    with replacing(path, "truth") as draft, draft.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
