"""Every reader of files, with a small sound file or folder for it to read: foreign formats, own stores, own texts."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from candata.datasets import append, create_dataset, open_dataset
from candata.datasets.clouds import put_cloud
from candata.datasets.encode import content_hash
from candata.formats import Reading, Writing
from candata.plugins import load
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from tests.conftest import WHOLE, make_episode
from tests.formats.made_bags import POSE_MAP, fox_pose, joints, poses, write_bag, write_foxglove, write_ros2
from tests.formats.made_sets import write_buffer, write_demos, write_lerobot, write_map, zipped


class Reader(NamedTuple):
    """One reader and what it reads.

    Attributes
    ----------
    write : callable
        `(folder, rows)`: writes sound files into an empty folder.
    read : callable
        `(folder) -> contents`; raises an error of candata where it refuses.
    files : str
        Pattern of the files that are mutated.
    whole : bool
        Whether hashes guard the contents: they are as they were written, or refused.
    """

    write: Callable[[Path, int], object]
    read: Callable[[Path], Any]
    files: str = "**/*"
    whole: bool = False


def _imported(format_name: str, source: str, mapping: str | None = None, **told: Any) -> Callable[[Path], list[str]]:
    """Return what reads a foreign format, and returns the hashes of its episodes."""

    def read(folder: Path) -> list[str]:
        path = None if mapping is None else folder / mapping
        given = Reading(allow_gaps=True, mapping=path, **told)
        return [
            _checked(episode) for episode in load("candata.formats", "FORMAT", format_name).read(folder / source, given)
        ]

    return read


def _checked(episode: Episode) -> str:
    """Return the hash of an episode whose stamps grow."""
    if not (len(episode) and (np.diff(episode["time_ns"]) > 0).all()):
        raise AssertionError("an episode whose stamps do not grow")
    return content_hash(episode)


def _table(kind: str, **more: Any) -> Callable[[Path, int], None]:
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


def _bag(folder: Path, rows: int) -> None:
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


def _bag_folder(folder: Path, rows: int) -> None:
    """Write a bag's folder of two files."""
    part = {"/pose": ("geometry_msgs/msg/PoseStamped", poses(rows))}
    write_bag(folder / "bag", [part])
    write_map(folder / "topics.yaml", **POSE_MAP)


def _frames(folder: Path, rows: int) -> None:
    """Write results of FoundationPose."""
    (folder / "run" / "ob_in_cam").mkdir(parents=True)
    for k in range(rows):
        np.savetxt(folder / "run" / "ob_in_cam" / f"{k:04d}.txt", np.eye(4))
    write_map(folder / "frames.yaml", rate_hz=30)


def _buffer(version: int, packed: bool = False) -> Callable[[Path, int], None]:
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


def _dataset(folder: Path, rows: int) -> None:
    """Write a dataset of two parts, a point cloud and taxels."""
    root = create_dataset(folder / "ds")
    cloud = put_cloud(root, np.eye(3))
    made = make_episode("t", rows=rows, point_cloud=cloud, newton_per_count=0.1)
    taxels = np.arange(rows * 2 * 120 * 3, dtype=np.int16).reshape(rows, 2, 120, 3)
    append(root, [make_episode("a", seed=1, rows=rows)], Lineage(operation="test"))
    append(root, [Episode(made.meta, {**made.arrays, "taxels": taxels})], Lineage(operation="test"))


def _read_dataset(folder: Path) -> list[str]:
    """Return the hashes of a dataset's episodes, after its checks were made."""
    from candata.checks import check

    opened = open_dataset(folder / "ds")
    list(check(opened, rules=WHOLE))
    return [content_hash(episode) for episode in opened]


def _read_windows(folder: Path) -> list[float]:
    """Return a sum over all windows of a dataset, by its cache."""
    from candata.loaders import windows

    found = windows(open_dataset(folder / "ds"), history=1, horizon=1, rate_hz=80.0, pad="both")
    return [float(np.nansum(np.asarray(v, np.float64))) for v in found.batch(np.arange(len(found))).values()]


def _cached(folder: Path, rows: int) -> None:
    """Write a dataset and the cache of its windows."""
    root = create_dataset(folder / "ds")
    append(root, [make_episode("a", seed=1, rows=rows), make_episode("b", rows=rows)], Lineage(operation="test"))
    _read_windows(folder)


def _pushed(folder: Path, rows: int) -> None:
    """Write a remote that a dataset was pushed to."""
    from candata.datasets.push import push
    from candata.datasets.remotes import open_remote
    from candata.schema.registry import RemoteEntry

    _dataset(folder, rows)
    (folder / "share").mkdir()
    push(folder / "ds", open_remote(RemoteEntry(url=str(folder / "share"))), "ds")


def _pull(folder: Path) -> list[str]:
    """Return the hashes of the episodes that a pull brings."""
    from candata.datasets.pull import pull
    from candata.datasets.remotes import open_remote
    from candata.schema.registry import RemoteEntry

    pull(open_remote(RemoteEntry(url=str(folder / "share"))), "ds", folder / "pulled")
    return [content_hash(episode) for episode in open_dataset(folder / "pulled")]


def _registry(folder: Path, rows: int) -> None:
    """Write a registry."""
    datasets = {f"set{k}": f"/data/set{k}" for k in range(rows)}
    value = {"registry_version": 1, "datasets": datasets, "remotes": {"lab": {"url": "s3://bucket/prefix"}}}
    (folder / "registry.json").write_text(json.dumps(value, indent=1))


def _read_registry(folder: Path) -> object:
    """Return a registry."""
    from candata.datasets.registry import read_registry

    return read_registry(folder / "registry.json")


_ARM = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
  <body name="upper"><joint name="shoulder" axis="0 0 1" limited="true" range="-57 57"/><geom name="arm" size=".1"/>
    <body name="lower" pos=".3 0 0"><joint name="rail" type="slide" axis="1 0 0"/><geom name="tip" size=".1"/></body>
  </body>
  <body name="box" pos="1 0 1"><freejoint/><geom name="box" type="box" size=".1 .1 .1"/></body>
  </worldbody><actuator>
    <position name="shoulder" joint="shoulder" kp="30" ctrllimited="true" ctrlrange="-2 2"/>
    <motor name="rail" joint="rail" ctrllimited="true" ctrlrange="-5 5"/>
  </actuator></mujoco>"""


def _scene(folder: Path, rows: int) -> None:
    """Write a model, its scene file and effects for it."""
    (folder / "arm.xml").write_text(_ARM)
    fields = {"model": "arm.xml", "rate_hz": 100, "object": "box", "joints": ["shoulder", "rail"]}
    fields |= {"actuators": ["shoulder", "rail"], "fingertips": ["tip"], "support": "floor"}
    fields |= {"groups": {"arm": ["shoulder"]}}
    noise = {"object_pose": [0.001, 0.009], "joint_position": 0.002, "fingertip_force": 0.02, "force_step": 0.05}
    write_map(folder / "scene.yaml", **fields, noise=noise)
    damping = {"name": "joint_damping", "element": "shoulder", "parameters": {"damping_Nms_rad": 0.1 * rows}}
    mass = {"name": "object_mass", "parameters": {"mass_scale": 1.2}}
    write_map(folder / "effects.yaml", scene="scene.yaml", effects=[damping, mass])


def _read_scene(folder: Path) -> object:
    """Return the digest of a scene."""
    from candata.scenes import load_scene

    return load_scene(folder / "scene.yaml").digest


@functools.cache
def _arm(text: str) -> Any:
    """Return the scene of the model that all sources share."""
    import tempfile

    from candata.scenes import load_scene

    with tempfile.TemporaryDirectory() as made:
        _scene(Path(made), 1)
        return load_scene(Path(made) / "scene.yaml")


def _read_effects(folder: Path) -> object:
    """Return the effects of a file, made for the scene."""
    from candata.effects import flatten, read_effects

    return [flatten(given, _arm(_ARM)).tolist() for given in read_effects(folder / "effects.yaml").effects]


def _motions(folder: Path, rows: int) -> None:
    """Write commands to play."""
    from candata.policies import Motion, write_motions

    values = np.linspace(0, 1, 2 * rows).reshape(rows, 2)
    motions = [Motion("slow", values, np.zeros(3)), Motion("far", -values, np.array([0.2, 0, 0]))]
    write_motions(folder / "motion.parquet", _arm(_ARM), motions)


def _read_motions(folder: Path) -> object:
    """Return commands to play."""
    from candata.policies import read_motions

    return read_motions(folder / "motion.parquet", _arm(_ARM)).digest


def _kept(folder: Path, rows: int) -> None:
    """Write arrays of a diagnosis."""
    from candata.gap import kept

    kept.keep(folder / "a.npz", raw=np.arange(6.0 * rows).reshape(2, 3, rows), flag=np.array([True, False]))


def _read_kept(folder: Path) -> object:
    """Return what was kept of a diagnosis, or that it is a miss."""
    from candata.errors import DataError
    from candata.gap import kept

    arrays = kept.read(folder / "a.npz")
    if arrays is None:
        raise DataError("a miss")
    return {name: (str(v.dtype), v.shape, v.tobytes()) for name, v in arrays.items()}


def _trained(folder: Path, rows: int) -> None:
    """Write what a training run leaves."""
    import torch

    from candata.training import checkpoint, runs
    from candata.training.settings import Progress
    from tests.training.conftest import make_run

    run = make_run(steps=rows)
    runs.begin(folder, run)
    weights = {"weights": {"layer.weight": torch.zeros(6, 2), "layer.bias": torch.zeros(6)}}
    checkpoint.save(folder / "last.safetensors", run, Progress(step=rows), weights)
    lines = [{"step": k, "loss": 1.0 / (k + 1)} for k in range(rows)]
    (folder / "log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


def _read_trained(folder: Path) -> object:
    """Return what a training run left."""
    from candata.training import checkpoint, runs, steplog

    run = runs.read_run(folder)
    kept = checkpoint.read(folder)
    return run, runs.read_splits(folder, run), steplog.read_log(folder), kept.tensors("weights")


def _log(folder: Path, rows: int) -> None:
    """Write the log of a hand, uncompressed."""
    from candata.record.devices._contract import States
    from candata.record.logs import LogMeta, LogWriter

    meta = LogMeta(
        device="d",
        joint_names=("a",),
        fingertip_names=("t",),
        taxels=2,
        newton_per_count=0.1,
        count_low=(-128, -128, 0),
        count_high=(127, 127, 255),
        rate_hz=80.0,
    )
    writer = LogWriter(folder / "log.mcap", meta)
    zeros = np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 3), np.int16), np.zeros((1, 1, 2, 3), np.int16)
    for k in range(rows):
        writer.states([k * 12_500_000], States(np.full((1, 1), 0.1 * k), *zeros))
    writer.statistics(0, {"rate_hz": 1.0})
    writer.close()


def _read_log(folder: Path) -> object:
    """Return the log of a hand, after it was recovered into another."""
    from candata.record.logs import read_log
    from candata.record.recover import recover

    recover(folder / "log.mcap", folder / "whole.mcap")
    return read_log(folder / "log.mcap").joint_position.tolist()


def _wire(folder: Path, rows: int) -> None:
    """Write what a serial hand says and hears."""
    from candata.record.devices import _xhand_frames as wire

    zeros = np.zeros((rows, 12)), np.zeros((rows, 5, 3), int), np.zeros((rows, 5, 120, 3), int)
    frames = [*wire.state_frames(*zeros), *wire.command_frames(np.zeros((rows, 12)))]
    (folder / "bytes").write_bytes(b"".join(frames))


def _read_wire(folder: Path) -> object:
    """Return what a serial hand said and heard; frames are also decoded with their sums made right."""
    from candata.record.devices import _xhand_frames as wire
    from candata.record.devices import device

    hand, path = device("xhand"), folder / "bytes"
    data = path.read_bytes() if path.exists() else b""
    framer = hand.framer()
    sealed = [wire.seal((wire.HEAD + body)[:-2]) for body in data.split(wire.HEAD)[1:]]
    frames = framer.feed(data, 0) + framer.feed(b"".join(sealed), 0) + framer.finish()
    states = hand.decode_states([f.data for f in frames if f.kind == "state"])
    commands = hand.decode_commands([f.data for f in frames if f.kind == "command"])
    return states.joint_position, commands.joint_target


def _poses_beside(folder: Path, rows: int) -> None:
    """Write a table of poses beside a log, and its map."""
    import pyarrow as pa
    import pyarrow.parquet

    names = ["px", "py", "pz", "qw", "qx", "qy", "qz"]
    columns = {"t": 1.76e9 + np.arange(rows) / 60} | {name: np.full(rows, float(name == "qw")) for name in names}
    pa.parquet.write_table(pa.table(columns), folder / "poses.parquet")
    write_map(folder / "map.yaml", file="poses.parquet", time_s="t", rate_hz=60, channels={"object_pose": names})


def _read_beside(folder: Path) -> object:
    """Return the streams of a table beside a log."""
    from candata.record.companions import read_companion

    return read_companion(folder / "map.yaml").digest


def _sealed(folder: Path, rows: int) -> None:
    """Write a sealed effect."""
    from candata.simulate import seal

    seal.keep(folder / "seal.json", _arm(_ARM), "joint_damping", rows, "0" * 64)


def _read_sealed(folder: Path) -> object:
    """Return a sealed effect."""
    from candata.simulate import seal

    return seal.read_seal(folder / "seal.json").effect


_BUFFER = _imported("diffusion_policy", "b.zarr", "map.yaml")
_OWN_BUFFER = _imported("diffusion_policy", "set/replay_buffer.zarr")
#: Readers of foreign formats, of candata's own stores, and of texts that users write.
FORMATS: Mapping[str, Reader] = {
    "table_parquet": Reader(_table("parquet"), _imported("table", "map.yaml"), "*.parquet"),
    "table_csv": Reader(_table("csv"), _imported("table", "map.yaml"), "*.csv"),
    "table_npz": Reader(_table("npz"), _imported("table", "map.yaml"), "*.npz"),
    "mcap_ros2": Reader(_bag, _imported("mcap", "run.mcap", "topics.yaml"), "*.mcap"),
    "mcap_without_map": Reader(_bag, _imported("mcap", "run.mcap"), "*.mcap"),
    "mcap_protobuf": Reader(_foxglove("protobuf"), _imported("mcap", "run.mcap", "topics.yaml"), "*.mcap"),
    "mcap_json": Reader(_foxglove("json"), _imported("mcap", "run.mcap", "topics.yaml"), "*.mcap"),
    "mcap_export": Reader(_export("mcap"), _imported("mcap", "set"), whole=True),
    "foundationpose": Reader(_frames, _imported("foundationpose", "run", "frames.yaml"), "**/*.txt"),
    "zarr_2": Reader(_buffer(2), _BUFFER, "b.zarr/**/*"),
    "zarr_3": Reader(_buffer(3), _BUFFER, "b.zarr/**/*"),
    "zarr_zip": Reader(_buffer(2, True), _imported("diffusion_policy", "b.zarr.zip", "map.yaml"), "*.zip"),
    "zarr_export": Reader(_export("diffusion_policy"), _OWN_BUFFER, whole=True),
    "hdf5": Reader(_demos, _imported("robomimic", "d.hdf5")),
    "hdf5_export": Reader(_export("robomimic"), _imported("robomimic", "set"), whole=True),
    "lerobot_3": Reader(_lerobot("v3.0"), _imported("lerobot", "set")),
    "lerobot_2": Reader(_lerobot("v2.1"), _imported("lerobot", "set")),
    "lerobot_2_export": Reader(_export("lerobot", variant="v21"), _imported("lerobot", "set"), whole=True),
    "lerobot_3_export": Reader(_export("lerobot"), _imported("lerobot", "set"), whole=True),
}
STORES: Mapping[str, Reader] = {
    "dataset": Reader(_dataset, _read_dataset, whole=True),
    "windows": Reader(_cached, _read_windows, "ds/cache/**/*", whole=True),
    "remote": Reader(_pushed, _pull, "share/**/*", whole=True),
    "registry": Reader(_registry, _read_registry),
    "kept": Reader(_kept, _read_kept, whole=True),
    "run": Reader(_trained, _read_trained),
    "motions": Reader(_motions, _read_motions),
    "log": Reader(_log, _read_log),
    "wire": Reader(_wire, _read_wire),
    "seal": Reader(_sealed, _read_sealed),
}
TEXTS: Mapping[str, Reader] = {
    "scene_yaml": Reader(_scene, _read_scene, "scene.yaml"),
    "effects_yaml": Reader(_scene, _read_effects, "effects.yaml"),
    "map_yaml": Reader(_table("parquet"), _imported("table", "map.yaml"), "map.yaml"),
    "topics_yaml": Reader(_bag, _imported("mcap", "run.mcap", "topics.yaml"), "topics.yaml"),
    "features_yaml": Reader(_buffer(2), _BUFFER, "map.yaml"),
    "frames_yaml": Reader(_frames, _imported("foundationpose", "run", "frames.yaml"), "*.yaml"),
    "bag_metadata": Reader(_bag_folder, _imported("mcap", "bag", "topics.yaml"), "bag/*.yaml"),
    "beside_yaml": Reader(_poses_beside, _read_beside, "map.yaml"),
}
READERS: Mapping[str, Reader] = {**FORMATS, **STORES, **TEXTS}
