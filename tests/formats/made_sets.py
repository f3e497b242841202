"""Small sets for learning as others write them: Diffusion Policy, robomimic, LeRobot; Git LFS pointers."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import yaml
import zarr

#: What git leaves in place of a file in a clone without git-lfs.
POINTER = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'c' * 64}\nsize 1234567\n"
JOINTS = ["thumb", "index"]


def write_map(path: Path, **fields: Any) -> Path:
    """Write a feature map."""
    path.write_text(yaml.safe_dump(fields, sort_keys=False))
    return path


def write_buffer(path: Path, version: int = 2, ends: Sequence[int] = (3, 5), **arrays: Any) -> Path:
    """Write a zarr buffer of two episodes, of three and of two rows; `arrays` are added or put in place."""
    shutil.rmtree(path, ignore_errors=True)
    root = zarr.open_group(str(path), mode="w", zarr_format=version)
    data = {"state": np.arange(10.0).reshape(5, 2), "action": np.ones((5, 2)), "img": np.ones((5, 4, 4, 3), np.uint8)}
    for name, values in (data | arrays).items():
        root.create_array(f"data/{name}", data=np.asarray(values))
    root.create_array("meta/episode_ends", data=np.array(ends))
    return path


def zipped(folder: Path, inside: str = "") -> Path:
    """Return a zip file of a buffer, below the folder `inside` of it."""
    path = folder.with_name(f"{folder.name}.zip")
    with zipfile.ZipFile(path, "w") as packed:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                packed.write(file, inside + file.relative_to(folder).as_posix())
    shutil.rmtree(folder)
    return path


def write_demos(path: Path, edit: Callable[[Any], object] = lambda file: None, rows: int = 5) -> Path:
    """Write a robomimic file of two demonstrations, changed by `edit`."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_group("data").attrs["env_args"] = json.dumps({"env_kwargs": {"control_freq": 20}})
        for k in range(2):
            demo = file.create_group(f"data/demo_{k}")
            demo.attrs["num_samples"] = rows
            demo["obs/robot0_joint_pos"] = np.full((rows, 7), float(k))
            demo["actions"] = np.zeros((rows, 7))
        edit(file)
    return path


def write_lerobot(
    root: Path,
    features: Mapping[str, dict] | None = None,
    columns: Mapping[str, Any] | None = None,
    version: str = "v3.0",
    fps: float = 50,
    rows: Sequence[int] = (4, 3),
    info: Mapping[str, Any] | None = None,
    edit: Callable[[list[dict]], object] = lambda lines: None,
) -> Path:
    """Write a LeRobot set; `columns` of None are left out, `edit` changes the list of episodes."""
    shutil.rmtree(root, ignore_errors=True)
    rng = np.random.default_rng(3)
    total = sum(rows)
    own = {"observation.state": feature("float32", 2, JOINTS), "action": feature("float32", 2, JOINTS)}
    own |= features or {}
    table: dict[str, Any] = {
        key: list(rng.normal(size=(total, one["shape"][0])))
        for key, one in own.items()
        if one["dtype"].startswith(("float", "int", "bool"))
    }
    frames = np.concatenate([np.arange(n) for n in rows])
    whose = np.repeat(np.arange(len(rows)), rows)
    table |= {"timestamp": (frames / fps).astype(np.float32), "frame_index": frames, "episode_index": whose}
    table |= {"index": np.arange(total), "task_index": np.zeros(total, int)} | dict(columns or {})
    arrays = {key: pa.array(v if np.ndim(v) < 2 else list(v)) for key, v in table.items() if v is not None}
    said = {"codebase_version": version, "fps": fps, "features": own, "total_episodes": len(rows)}
    said |= {"total_frames": total, "chunks_size": 1000, "robot_type": "hand"}
    lines: list[dict] = [{"episode_index": k, "tasks": ["grasp it"], "length": n} for k, n in enumerate(rows)]
    (root / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    (root / "data" / "chunk-000").mkdir(parents=True)
    if version == "v3.0":
        said["data_path"] = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
        for line in lines:
            line |= {"data/chunk_index": 0, "data/file_index": 0}
        edit(lines)
        pq.write_table(pa.Table.from_pylist(lines), root / "meta/episodes/chunk-000/file-000.parquet")
        pq.write_table(pa.table(arrays), root / "data/chunk-000/file-000.parquet")
    else:
        said["data_path"] = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
        edit(lines)
        (root / "meta/episodes.jsonl").write_text("\n".join(json.dumps(line) for line in lines))
        for k in range(len(rows)):
            part = pa.table(arrays).filter(pc.equal(pa.array(whose), k))
            pq.write_table(part, root / f"data/chunk-000/episode_{k:06d}.parquet")
    (root / "meta/info.json").write_text(json.dumps(said | dict(info or {})))
    return root


def feature(dtype: str, width: int, names: Any = None) -> dict:
    """Return a feature as `meta/info.json` has it."""
    return {"dtype": dtype, "shape": [width], "names": names}


def sparse(path: Path, size_bytes: int) -> Path:
    """Make a file as large as `size_bytes` without writing that many: blanks follow what it holds."""
    with path.open("ab") as file:
        file.truncate(size_bytes)
    return path


def table_source(self, folder: Path) -> tuple[Path, None]:
    """A table of one episode with its map, as a conformance suite asks for it."""
    folder.mkdir()
    rows = 20
    columns = {"t": np.arange(rows) * 0.0125, "q": np.sin(np.arange(rows)), "a": np.cos(np.arange(rows))}
    pq.write_table(pa.table(columns), folder / "episode.parquet")
    channels = {"joint_position": ["q"], "action": ["a"]}
    fields = {"file": "episode.parquet", "source": "real", "time_s": "t", "rate_hz": 80, "channels": channels}
    return write_map(folder / "map.yaml", **fields), None


def foundationpose_source(self, folder: Path) -> tuple[Path, Path]:
    """Poses of a thing that stands still, as a conformance suite asks for them."""
    (folder / "ob_in_cam").mkdir(parents=True)
    for k in range(6):
        np.savetxt(folder / "ob_in_cam" / f"{k:07d}.txt", np.eye(4))
    return folder, write_map(folder.parent / "frames.yaml", rate_hz=30)
