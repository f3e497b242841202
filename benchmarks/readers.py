"""What pictures cost that an import is not asked for: memory and time beside the format's own library.

    python benchmarks/readers.py [--megabytes 300] [--rounds 5] [--scratch FOLDER]

Writes a set of 14 columns (seven joints, seven commands) and 300 MB of pictures as a zarr buffer, a robomimic HDF5 file
and a LeRobot set with the pictures in a Parquet column. Each way runs in a process of its own, in turn: `library` reads
the 14 columns with zarr, h5py or pyarrow alone, `columns` reads them with candata, episode by episode. `episodes` also
reads the map, puts the numbers in SI, checks every value and makes episodes; `import` writes these into a dataset, as
`candata import` does. Memory is the peak of the process beyond what it held once all modules were imported; time begins
there too, and is that of the CPU. Files are in the page cache for all. The target of memory is asked of the import,
that of time of reading the columns; what checks and writing take is printed beside it.
"""

from __future__ import annotations

import argparse
import gc
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

JOINTS, EPISODES, PICTURE, RATE_HZ = 7, 20, (96, 96, 3), 10.0
MOST_MB, MOST_TIMES = 100.0, 1.2
FORMATS = {"diffusion_policy": "zarr", "robomimic": "h5py", "lerobot": "pyarrow"}
MAPS = {
    "diffusion_policy": {"joint_position": "state", "action": "action"},
    "robomimic": {"joint_position": "obs/state", "action": "actions"},
    "lerobot": {"joint_position": "observation.state", "action": "action"},
}


def write(name: str, root: Path, rows: int) -> None:
    """Write a set of a format, and its map beside it."""
    rng = np.random.default_rng(0)
    state, action = (rng.normal(size=(rows, JOINTS)).astype(np.float32) for _ in range(2))
    ends = np.linspace(0, rows, EPISODES + 1).astype(int)[1:]
    pictures = rng.integers(0, 256, (rows, *PICTURE), np.uint8)
    root.mkdir(exist_ok=True)
    _WRITERS[name](root, state, action, pictures, ends)
    (root / "map.yaml").write_text(json.dumps({"rate_hz": RATE_HZ, "channels": MAPS[name]}))


def _zarr(root: Path, state: np.ndarray, action: np.ndarray, pictures: np.ndarray, ends: np.ndarray) -> None:
    """Write a Diffusion Policy buffer, a picture a chunk."""
    import zarr

    group = zarr.open_group(str(root / "set.zarr"), mode="w", zarr_format=2)
    for key, values in (("data/state", state), ("data/action", action), ("meta/episode_ends", ends)):
        group.create_array(key, data=values)
    group.create_array("data/img", data=pictures, chunks=(1, *PICTURE))


def _hdf5(root: Path, state: np.ndarray, action: np.ndarray, pictures: np.ndarray, ends: np.ndarray) -> None:
    """Write a robomimic file."""
    import h5py

    with h5py.File(root / "set.hdf5", "w") as file:
        for k, (first, last) in enumerate(zip([0, *ends], ends, strict=False)):
            demo = file.create_group(f"data/demo_{k}")
            demo.attrs["num_samples"] = last - first
            demo["obs/state"], demo["actions"] = state[first:last], action[first:last]
            demo["obs/camera"] = pictures[first:last]


def _lerobot(root: Path, state: np.ndarray, action: np.ndarray, pictures: np.ndarray, ends: np.ndarray) -> None:
    """Write a LeRobot v3.0 set of one file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    lengths = np.diff([0, *ends])
    frames, whose = np.concatenate([np.arange(n) for n in lengths]), np.repeat(np.arange(len(lengths)), lengths)
    for folder in ("meta/episodes/chunk-000", "data/chunk-000"):
        (root / folder).mkdir(parents=True)
    columns = {"observation.state": list(state), "action": list(action), "frame_index": frames, "episode_index": whose}
    columns |= {"timestamp": (frames / RATE_HZ).astype(np.float32), "index": np.arange(len(state))}
    columns |= {"observation.image": pa.array([one.tobytes() for one in pictures])}
    pq.write_table(pa.table(columns), root / "data/chunk-000/file-000.parquet", row_group_size=1000)
    numbers = {"dtype": "float32", "shape": [JOINTS], "names": None}
    features = {"observation.state": numbers, "action": numbers}
    features |= {"observation.image": {"dtype": "image", "shape": list(PICTURE), "names": None}}
    info = {"codebase_version": "v3.0", "fps": RATE_HZ, "features": features, "total_episodes": len(lengths)}
    info |= {"total_frames": len(state), "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"}
    (root / "meta/info.json").write_text(json.dumps(info))
    place = {"tasks": ["t"], "data/chunk_index": 0, "data/file_index": 0}
    lines = [{"episode_index": k, "length": int(n), **place} for k, n in enumerate(lengths)]
    pq.write_table(pa.Table.from_pylist(lines), root / "meta/episodes/chunk-000/file-000.parquet")


_WRITERS = {"diffusion_policy": _zarr, "robomimic": _hdf5, "lerobot": _lerobot}


def library(name: str, source: Path) -> Callable[[], int]:
    """Return what reads the columns of a set with the format's own library, and counts the rows."""
    if name == "diffusion_policy":
        import zarr

        def read() -> int:
            group = zarr.open_group(str(source), mode="r")
            state, action, ends = (group[key][:] for key in ("data/state", "data/action", "meta/episode_ends"))
            return sum(len(part) for part in np.split(np.c_[state, action], ends[:-1]))

    elif name == "robomimic":
        import h5py

        def read() -> int:
            with h5py.File(source, "r") as file:
                demos = [np.c_[demo["obs/state"][:], demo["actions"][:]] for demo in file["data"].values()]
            return sum(map(len, demos))

    else:
        import pyarrow.parquet as pq

        def read() -> int:
            columns = [*MAPS[name].values(), "timestamp", "frame_index", "episode_index"]
            table = pq.read_table(source / "data/chunk-000/file-000.parquet", columns=columns)
            flat = (table[key].combine_chunks().flatten().to_numpy() for key in MAPS[name].values())
            state, action = (values.reshape(-1, JOINTS) for values in flat)
            ends = np.flatnonzero(np.diff(table["episode_index"].to_numpy())) + 1
            return sum(len(part) for part in np.split(np.c_[state, action], ends))

    return read


def columns(name: str, source: Path) -> Callable[[], int]:
    """Return what reads the columns of a set with candata's own readers, and counts the rows."""
    if name == "diffusion_policy":
        from candata.formats._zarr_buffer import episode_rows, find_buffer, open_array, read_rows

        def read() -> int:
            buffer = find_buffer(source)
            arrays = {key: open_array(buffer, key) for key in ("data/state", "data/action", "meta/episode_ends")}
            ends = read_rows(buffer, "meta/episode_ends", arrays.pop("meta/episode_ends"), 0, EPISODES).tolist()
            streams = [episode_rows(buffer, key, array, ends) for key, array in arrays.items()]
            return sum(len(np.concatenate(parts, axis=1)) for parts in zip(*streams, strict=True))

    elif name == "robomimic":
        import h5py

        from candata.formats._hdf5_datasets import load, open_dataset, open_group

        def read() -> int:
            with h5py.File(source, "r") as file:
                data = open_group(file, "data", source)
                demos = (open_group(data, demo, source) for demo in data)
                pairs = (
                    [load(open_dataset(demo, key, source), source) for key in MAPS[name].values()] for demo in demos
                )
                return sum(len(np.concatenate(parts, axis=1)) for parts in pairs)

    else:
        from candata.formats._lerobot_layout import open_folder
        from candata.formats._lerobot_rows import episode_arrays

        def read() -> int:
            found = episode_arrays(open_folder(source), tuple(MAPS[name].values()), print)
            return sum(len(np.concatenate([rows[key] for key in MAPS[name].values()], axis=1)) for _, rows in found)

    return read


def episodes(name: str, source: Path) -> Callable[[], int]:
    """Return what reads a set with candata, and counts the rows."""
    from candata.formats import Reading
    from candata.plugins import load

    found = load("candata.formats", "FORMAT", name)
    if name == "robomimic":
        import h5py  # noqa: F401  # as the library's way, before the clock starts
    mapping = (source if source.name == name else source.parent) / "map.yaml"
    return lambda: sum(len(one) for one in found.read(source, Reading(mapping=mapping)))


def imported(name: str, source: Path) -> Callable[[], int]:
    """Return what imports a set as the command does, and counts the rows."""
    import candata.datasets
    from candata.schema.manifest import Lineage

    mapping = (source if source.name == name else source.parent) / "map.yaml"
    episodes(name, source)  # imports the reader

    def run() -> int:
        from candata.formats import Reading
        from candata.plugins import load

        with tempfile.TemporaryDirectory() as folder:
            root = candata.datasets.create_dataset(Path(folder) / "out")
            read = load("candata.formats", "FORMAT", name).read(source, Reading(mapping=mapping))
            candata.datasets.append(root, read, Lineage(operation="benchmark"))
            return sum(len(one) for one in candata.datasets.open_dataset(root))

    return run


WAYS = {"library": library, "columns": columns, "episodes": episodes, "import": imported}


def probe(way: str, name: str, source: Path) -> None:
    """Print what one way takes, as JSON: seconds, and MB beyond what was held before."""
    run = WAYS[way](name, source)
    gc.collect()  # of what the imports made, which is no part of reading
    gc.freeze()
    before = _status("VmRSS")
    imports_mb = _status("VmHWM")
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    begin = time.process_time()
    rows = run()
    seconds = time.process_time() - begin
    peak = _status("VmHWM")
    print(json.dumps({"rows": rows, "s": seconds, "mb": peak - before, "whole_mb": max(peak, imports_mb)}))


def _status(key: str) -> float:
    """Return a line of the process's status [MB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key)) / 1024


def source_of(name: str, root: Path) -> Path:
    """Return what is imported."""
    return {"diffusion_policy": root / "set.zarr", "robomimic": root / "set.hdf5", "lerobot": root}[name]


def measure(name: str, root: Path, rounds: int, megabytes: float) -> bool:
    """Print what a format takes; tell whether it meets the targets."""
    found: dict[str, list[dict]] = {way: [] for way in WAYS}
    for _ in range(rounds):
        for way in WAYS:
            command = [sys.executable, __file__, "--probe", way, name, str(source_of(name, root))]
            ran = subprocess.run(command, capture_output=True, text=True, check=True)
            found[way].append(json.loads(ran.stdout))
    middle = {way: {key: float(np.median([one[key] for one in ran])) for key in ran[0]} for way, ran in found.items()}
    columns_mb = middle["library"]["rows"] * JOINTS * 2 * 4 / 1e6
    own_mb = {way: one["mb"] - columns_mb for way, one in middle.items()}
    times = {way: one["s"] / middle["library"]["s"] for way, one in middle.items()}
    met = own_mb["import"] <= MOST_MB and times["columns"] <= MOST_TIMES
    print(f"{'met ' if met else 'MISS'} {name}: {megabytes:.0f} MB of pictures, {columns_mb:.2f} MB of columns")
    for what, unit, factor, digits, aim in (
        ("memory beside the columns", "MB", 1.0, 0, f"import <= {MOST_MB:.0f} MB"),
        ("whole process", "MB", 1.0, 0, ""),
        ("CPU time", "ms", 1e3, 1, f"columns <= {MOST_TIMES} times {FORMATS[name]}"),
    ):
        key = {"memory beside the columns": own_mb, "whole process": {w: one["whole_mb"] for w, one in middle.items()}}
        values = key.get(what, {way: one["s"] for way, one in middle.items()})
        shown = ", ".join(
            f"{FORMATS[name] if way == 'library' else way} {factor * value:.{digits}f}"
            + (f" ({times[way]:.2f} times)" if what == "CPU time" else "")
            for way, value in values.items()
        )
        print(f"       {what} [{unit}]: {shown}" + (f"; target: {aim}" if aim else ""))
    return met


def main() -> None:
    """Measure all formats; exit 1 where a target is missed."""
    parser = argparse.ArgumentParser(description="Measure imports of sets with pictures that are not asked for.")
    parser.add_argument("--megabytes", type=float, default=300.0, help="pictures of each set [300]")
    parser.add_argument("--rounds", type=int, default=5, help="processes of each way [5]")
    parser.add_argument("--scratch", type=Path, help="where the sets are written [a temporary folder]")
    parser.add_argument("--probe", nargs=3, metavar=("WAY", "FORMAT", "SOURCE"), help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.probe:
        probe(chosen.probe[0], chosen.probe[1], Path(chosen.probe[2]))
        return
    rows = round(chosen.megabytes * 1e6 / np.prod(PICTURE))
    met = []
    with tempfile.TemporaryDirectory(dir=chosen.scratch) as folder:
        for name in FORMATS:
            root = Path(folder) / name
            write(name, root, rows)
            met.append(measure(name, root, chosen.rounds, chosen.megabytes))
    sys.exit(0 if all(met) else 1)


if __name__ == "__main__":
    main()
