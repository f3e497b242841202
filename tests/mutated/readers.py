"""Every reader of files, with a small sound file or folder for it to read: foreign formats, own stores, own texts."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from candata.datasets import append, create_dataset, open_dataset
from candata.datasets.clouds import put_cloud
from candata.datasets.encode import content_hash
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from tests.conftest import WHOLE, make_episode
from tests.formats.made_sets import write_map
from tests.mutated.format_readers import BUFFER, FORMATS, bag, bag_folder, buffer, frames, imported, table
from tests.mutated.reader import Reader


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


def _mesh(ending: str) -> Callable[[Path, int], None]:
    """Return what writes a mesh of `rows` boxes in a row as a file of a kind."""

    def write(folder: Path, rows: int) -> None:
        import trimesh

        beams = [trimesh.creation.box((0.02, 0.03, 0.05)).apply_translation((0.03 * k, 0, 0)) for k in range(rows)]
        trimesh.util.concatenate(beams).export(folder / f"mesh.{ending}")

    return write


def _read_mesh(ending: str) -> Callable[[Path], object]:
    """Return what makes an object of a mesh, after two drops from random attitudes."""

    def read(folder: Path) -> object:
        import tempfile

        from candata.scenes.object_making import ObjectSource, make_object

        with tempfile.TemporaryDirectory() as made:
            source = ObjectSource(folder / f"mesh.{ending}", "thing", 0.1)
            return make_object(source, Path(made) / "thing", drops=2).scene_object.file

    return read


def _object(folder: Path, rows: int) -> None:
    """Write an object of a box."""
    rest = {"quaternion": [1, 0, 0, 0], "height_m": 0.025, "probability": 0.5, "tilt_rad": 0.0}
    shape = {"type": "box", "size_m": [0.01, 0.015, 0.025]}
    fields = {"name": "brick", "about": "a brick", "mass_kg": 0.1 * rows, "visual": shape, "inertia": "exact"}
    write_map(folder / "object.yaml", **fields, pieces=[shape] * rows, rests=[rest])


def _read_object(folder: Path) -> object:
    """Return the digest of a scene with an object."""
    from candata.scenes import load_scene

    return load_scene(f"cube_toss+{folder}").digest


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
    from candata.gap.run import cache as kept

    kept.keep(folder / "a.npz", raw=np.arange(6.0 * rows).reshape(2, 3, rows), flag=np.array([True, False]))


def _read_kept(folder: Path) -> object:
    """Return what was kept of a diagnosis, or that it is a miss."""
    from candata.errors import DataError
    from candata.gap.run import cache as kept

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

    return seal.read_seal(folder / "seal.json").effects


#: Readers of candata's own stores, of texts that users write, and all of them, by name.
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
    "object_yaml": Reader(_object, _read_object),
    "scene_yaml": Reader(_scene, _read_scene, "scene.yaml"),
    "effects_yaml": Reader(_scene, _read_effects, "effects.yaml"),
    "map_yaml": Reader(table("parquet"), imported("table", "map.yaml"), "map.yaml"),
    "topics_yaml": Reader(bag, imported("mcap", "run.mcap", "topics.yaml"), "topics.yaml"),
    "features_yaml": Reader(buffer(2), BUFFER, "map.yaml"),
    "frames_yaml": Reader(frames, imported("foundationpose", "run", "frames.yaml"), "*.yaml"),
    "bag_metadata": Reader(bag_folder, imported("mcap", "bag", "topics.yaml"), "bag/*.yaml"),
    "beside_yaml": Reader(_poses_beside, _read_beside, "map.yaml"),
}
MESHES: Mapping[str, Reader] = {
    f"mesh_{ending}": Reader(_mesh(ending), _read_mesh(ending)) for ending in ("obj", "ply", "stl")
}
READERS: Mapping[str, Reader] = {**FORMATS, **STORES, **TEXTS, **MESHES}
