"""Every reader of foreign formats, with a small sound file or folder for it to read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from candata.datasets.encode import content_hash
from candata.formats import Reading, Writing
from candata.plugins import load
from candata.schema.episode import Episode
from tests.conftest import make_episode
from tests.formats.made_bags import POSE_MAP, fox_pose, joints, poses, write_bag, write_foxglove, write_ros2
from tests.formats.made_sets import write_buffer, write_demos, write_lerobot, write_map, zipped
from tests.mutated.reader import Reader


def imported(format_name: str, source: str, mapping: str | None = None, **told: Any) -> Callable[[Path], list[str]]:
    """Return what reads a foreign format, and returns the hashes of its episodes."""

    def read(folder: Path) -> list[str]:
        path = None if mapping is None else folder / mapping
        given = Reading(allow_gaps=True, mapping=path, **told)
        return [
            checked_hash(episode)
            for episode in load("candata.formats", "FORMAT", format_name).read(folder / source, given)
        ]

    return read


def checked_hash(episode: Episode) -> str:
    """Return the hash of an episode whose stamps grow."""
    if not (len(episode) and (np.diff(episode["time_ns"]) > 0).all()):
        raise AssertionError("an episode whose stamps do not grow")
    return content_hash(episode)


def table(kind: str, **more: Any) -> Callable[[Path, int], None]:
    """Return what writes a table of two episodes, and its map."""

    def write(folder: Path, rows: int) -> None:
        import pyarrow as pa
        import pyarrow.csv
        import pyarrow.parquet

        rng = np.random.default_rng(rows)
        columns = {"episode": np.repeat([4, 2], rows), "t": np.tile(np.arange(rows) / 100, 2)}
        columns |= {name: rng.normal(size=2 * rows) for name in ("q0", "q1", "a0", "a1", "f_x", "f_y", "f_z")}
        path = folder / f"run.{kind}"
        if kind == "npz":
            np.savez(path, **columns)
        elif kind == "csv":
            pa.csv.write_csv(pa.table(columns), path)
        else:
            pa.parquet.write_table(pa.table(columns), path)
        channels = {"joint_position": ["q0", "q1"], "action": ["a0", "a1"], "fingertip_force": [["f_x", "f_y", "f_z"]]}
        fields = {"file": path.name, "episode": "episode", "time_s": "t", "rate_hz": 100, "channels": channels}
        write_map(folder / "map.yaml", **fields, units={"q0": "deg"}, **more)

    return write


def _export(format_name: str, **told: Any) -> Callable[[Path, int], None]:
    """Return what writes an export of candata's own."""

    def write(folder: Path, rows: int) -> None:
        episodes = [make_episode("a", rows=rows), make_episode("b", seed=1, rows=rows + 1)]
        (folder / "set").mkdir()
        load("candata.formats", "FORMAT", format_name).write(episodes, folder / "set", Writing("ds", "d" * 64, **told))

    return write


def bag(folder: Path, rows: int) -> None:
    """Write a bag as rosbag2 does: neither compressed nor with check sums, so that damage reaches the messages."""
    from mcap.writer import CompressionType

    pose, joint = ("geometry_msgs/msg/PoseStamped", poses(rows)), ("sensor_msgs/msg/JointState", joints(rows))
    topics = {"/pose": pose, "/j": joint}
    write_ros2(folder / "run.mcap", topics, compression=CompressionType.NONE, enable_crcs=False)
    channels = {"object_pose": "/pose", "joint_position": {"topic": "/j", "clock": "log"}}
    write_map(folder / "topics.yaml", rate_hz=100, channels=channels)


def _foxglove(encoding: str) -> Callable[[Path, int], None]:
    """Return what writes a recording of Foxglove's messages."""

    def write(folder: Path, rows: int) -> None:
        items: list[Any] = [fox_pose(10**9 + k * 10**7, float(k)) for k in range(rows)]
        if encoding == "json":
            pose = {"position": {"x": 1, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
            items = [(t, {"timestamp": {"sec": 1, "nsec": t - 10**9}, "pose": pose}) for t, _ in items]
        write_foxglove(folder / "run.mcap", {"/pose": ("foxglove.PoseInFrame", items)}, encoding)
        write_map(folder / "topics.yaml", **POSE_MAP)

    return write


def bag_folder(folder: Path, rows: int) -> None:
    """Write a bag's folder of two files."""
    part = {"/pose": ("geometry_msgs/msg/PoseStamped", poses(rows))}
    write_bag(folder / "bag", [part])
    write_map(folder / "topics.yaml", **POSE_MAP)


def frames(folder: Path, rows: int) -> None:
    """Write results of FoundationPose."""
    (folder / "run" / "ob_in_cam").mkdir(parents=True)
    for k in range(rows):
        np.savetxt(folder / "run" / "ob_in_cam" / f"{k:04d}.txt", np.eye(4))
    write_map(folder / "frames.yaml", rate_hz=30)


def buffer(version: int, packed: bool = False) -> Callable[[Path, int], None]:
    """Return what writes a buffer of Diffusion Policy, without pictures."""

    def write(folder: Path, rows: int) -> None:
        made = write_buffer(folder / "b.zarr", version, ends=(rows, 5), state=np.arange(10.0).reshape(5, 2))
        if packed:
            zipped(made)
        write_map(folder / "map.yaml", rate_hz=10, channels={"joint_position": "state", "action": "action"})

    return write


def _demos(folder: Path, rows: int) -> None:
    """Write a file of robomimic."""
    write_demos(folder / "d.hdf5", rows=rows)


def _lerobot(version: str) -> Callable[[Path, int], None]:
    """Return what writes a set of LeRobot."""
    return lambda folder, rows: write_lerobot(folder / "set", version=version, rows=(rows, 3))


BUFFER = imported("diffusion_policy", "b.zarr", "map.yaml")
_OWN_BUFFER = imported("diffusion_policy", "set/replay_buffer.zarr")
#: Readers of foreign formats, by name.
FORMATS: Mapping[str, Reader] = {
    "table_parquet": Reader(table("parquet"), imported("table", "map.yaml"), "*.parquet"),
    "table_csv": Reader(table("csv"), imported("table", "map.yaml"), "*.csv"),
    "table_npz": Reader(table("npz"), imported("table", "map.yaml"), "*.npz"),
    "mcap_ros2": Reader(bag, imported("mcap", "run.mcap", "topics.yaml"), "*.mcap"),
    "mcap_without_map": Reader(bag, imported("mcap", "run.mcap"), "*.mcap"),
    "mcap_protobuf": Reader(_foxglove("protobuf"), imported("mcap", "run.mcap", "topics.yaml"), "*.mcap"),
    "mcap_json": Reader(_foxglove("json"), imported("mcap", "run.mcap", "topics.yaml"), "*.mcap"),
    "mcap_export": Reader(_export("mcap"), imported("mcap", "set"), whole=True),
    "foundationpose": Reader(frames, imported("foundationpose", "run", "frames.yaml"), "**/*.txt"),
    "zarr_2": Reader(buffer(2), BUFFER, "b.zarr/**/*"),
    "zarr_3": Reader(buffer(3), BUFFER, "b.zarr/**/*"),
    "zarr_zip": Reader(buffer(2, True), imported("diffusion_policy", "b.zarr.zip", "map.yaml"), "*.zip"),
    "zarr_export": Reader(_export("diffusion_policy"), _OWN_BUFFER, whole=True),
    "hdf5": Reader(_demos, imported("robomimic", "d.hdf5")),
    "hdf5_export": Reader(_export("robomimic"), imported("robomimic", "set"), whole=True),
    "lerobot_3": Reader(_lerobot("v3.0"), imported("lerobot", "set")),
    "lerobot_2": Reader(_lerobot("v2.1"), imported("lerobot", "set")),
    "lerobot_2_export": Reader(_export("lerobot", variant="v21"), imported("lerobot", "set"), whole=True),
    "lerobot_3_export": Reader(_export("lerobot"), imported("lerobot", "set"), whole=True),
}
