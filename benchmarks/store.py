"""What the store does: bulk writing, opening and filtering 100,000 episodes, kills, memory of a full scan.

    python benchmarks/store.py --scratch FOLDER             the promises, beside their targets, misses first
    python benchmarks/store.py --size 0.2 --kills 3         a quick run

Seconds are of CPU time of one core, medians. The set that is scanned is made once in --scratch and taken again by later
runs; without --scratch all is made in a temporary folder. Episodes are of 300 steps: pose 7, joints 19, action 19,
forces 15 float32, contact 5 bool, noisy walks that hardly compress. Writing counts from numpy arrays to a published
version: checks, hashes, encoding, fsync. Beside it stand pyarrow's own defaults on the same rows, without any of these.
"""

from __future__ import annotations

import argparse
import hashlib
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from candata.datasets import append, create_dataset, encode, open_dataset, parts
from candata.datasets.durable import encode_record
from candata.datasets.kill_test import kill_test
from candata.datasets.versions import digest_of, version_path
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import FileEntry, Lineage, PartFile, VersionFile

STEPS, CATALOG_PARTS, PER_PART = 300, 400, 256
NAMES = {
    "joint_names": tuple(f"joint_{i}" for i in range(19)),
    "actuator_names": tuple(f"joint_{i}" for i in range(19)),
    "fingertip_names": tuple("abcde"),
}


@dataclass(frozen=True)
class Row:
    """A figure, its target and whether it is met."""

    met: bool
    text: str


def arrays(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the channels of one episode."""

    def walk(width: int) -> np.ndarray:
        return np.cumsum(rng.normal(scale=0.01, size=(STEPS, width)), axis=0).astype(np.float32)

    pose = walk(7)
    pose[:, 3:] = (1, 0, 0, 0)
    return {
        "time_ns": np.arange(STEPS) * 12_500_000,
        "object_pose": pose,
        "joint_position": walk(19),
        "action": walk(19),
        "fingertip_force": walk(15).reshape(STEPS, 5, 3),
        "fingertip_contact": rng.random((STEPS, 5)) > 0.5,
    }


def episodes(count: int, first: int = 0) -> Iterator[Episode]:
    """Yield episodes; their values come from a few draws, each shifted by its number so that none equals another."""
    drawn = [arrays(np.random.default_rng(i)) for i in range(32)]
    for number in range(first, first + count):
        values = dict(drawn[number % len(drawn)])
        values["joint_position"] = values["joint_position"] + np.float32(number)
        yield Episode(EpisodeMeta(id=f"{number:07d}", source="sim", rate_hz=80, seed=number, **NAMES), values)


def cpu_s(work: Callable[[], object]) -> float:
    """Return the CPU seconds of a piece of work."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def writing(folder: Path, count: int, rounds: int) -> list[Row]:
    """Measure writing in bulk, in parts of 16 and of 256, beside plain tables."""

    def plain(target: Path) -> None:
        schema, waiting = None, []
        for episode in episodes(count):
            schema = schema or encode.steps_schema(encode.layout_of(episode))
            waiting.append(encode.steps_batch(episode, schema))
        with pq.ParquetWriter(target, schema, compression="zstd") as writer:
            for i in range(0, count, 8):
                writer.write_table(pa.Table.from_batches(waiting[i : i + 8]))

    spent: dict[str, list[float]] = {"16": [], "256": [], "plain": []}
    for turn in range(rounds):
        for size in ("16", "256"):
            root = create_dataset(folder / f"write-{size}-{turn}")
            work = lambda: append(root, episodes(count), Lineage(operation="benchmark"), int(size))  # noqa: B023, E731
            spent[size].append(cpu_s(work))
        spent["plain"].append(cpu_s(lambda: plain(folder / f"plain-{turn}.parquet")))  # noqa: B023
    speed = {name: count / float(np.median(values)) for name, values in spent.items()}
    ours = bytes_of(folder / "write-256-0")
    return [
        Row(
            speed[size] >= 500,
            f"write, parts of {size}: {speed[size]:,.0f} episodes per core-second (target >= 500); plain pyarrow "
            f"tables {speed['plain']:,.0f}; kB an episode {ours / count / 1e3:.0f}, plain "
            f"{(folder / 'plain-0.parquet').stat().st_size / count / 1e3:.0f}",
        )
        for size in ("16", "256")
    ]


def catalog_set(root: Path) -> Path:
    """Return a dataset of 102,400 episodes whose tables of steps are stand-ins: opening never reads them."""
    if version_path(root, 1).is_file():
        return root
    create_dataset(root, exist_ok=True)
    rng, entries, index = np.random.default_rng(0), [], {}
    for number in range(CATALOG_PARTS):
        rows = [catalog_row(number * PER_PART + i, rng.bytes(32).hex()) for i in range(PER_PART)]
        pairs = tuple((str(row["id"]), str(row["content_hash"])) for row in rows)
        index |= dict(pairs)
        part_id = parts.part_id_of(list(pairs))
        folder = parts.part_folder(root, part_id)
        folder.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.Table.from_pylist(rows, encode.EPISODE_COLUMNS), folder / parts.EPISODES, compression="zstd")
        (folder / parts.STEPS).write_bytes(b"PAR1")
        files = tuple(
            FileEntry(path=p.name, bytes=p.stat().st_size, sha256=hashlib.sha256(p.read_bytes()).hexdigest())
            for p in (folder / parts.STEPS, folder / parts.EPISODES)
        )
        manifest = PartFile(id=part_id, files=files, rows=STEPS * PER_PART, episodes=pairs)
        (folder / parts.MANIFEST).write_bytes(encode_record(manifest))
        entries.append(parts.entry_of(root, part_id))
    version = VersionFile(number=1, parts=tuple(entries), digest=digest_of(index))
    version_path(root, 1).parent.mkdir(exist_ok=True)
    version_path(root, 1).write_bytes(encode_record(version))
    return root


def catalog_row(number: int, digest: str) -> dict[str, object]:
    """Return the row of one episode of the synthetic catalog."""
    meta = EpisodeMeta(
        id=f"ep-{number:06d}",
        source="sim" if number % 2 else "real",
        rate_hz=80,
        scene="xhand_tabletop",
        object=("cup", "box", "can")[number % 3],
        seed=number,
        outcome="drop" if number % 5 else "success",
        **NAMES,
    )
    return {
        "id": meta.id,
        "source": meta.source,
        "scene": meta.scene,
        "object": meta.object,
        "task": None,
        "seed": meta.seed,
        "effects": None,
        "outcome": meta.outcome,
        "rate_hz": meta.rate_hz,
        "rows": STEPS,
        "duration_s": 3.7375,
        "joint_names": meta.joint_names,
        "actuator_names": meta.actuator_names,
        "fingertip_names": meta.fingertip_names,
        "content_hash": digest,
        "row_group": number % PER_PART // 8,
        "meta": encode.meta_json(meta),
    }


def catalogs(root: Path, rounds: int) -> list[Row]:
    """Measure opening and filtering a large dataset."""
    catalog_set(root)
    dataset = open_dataset(root)
    dataset.catalog()

    def chosen() -> int:
        table = dataset.catalog(["id", "object", "outcome", "duration_s"])
        wanted = (pc.field("object") == "cup") & (pc.field("outcome") == "success") & (pc.field("duration_s") > 1)
        return len(table.filter(wanted)["id"])

    opened = float(np.median([cpu_s(lambda: open_dataset(root)) for _ in range(rounds)]))
    filtered = float(np.median([cpu_s(chosen) for _ in range(rounds)]))
    whole = float(np.median([cpu_s(dataset.catalog) for _ in range(rounds)]))
    size = f"{len(dataset):,} episodes"
    return [
        Row(opened < 0.5, f"open {size} in {CATALOG_PARTS} parts: {opened:.3f} CPU s (target < 0.5)"),
        Row(
            filtered < 0.1,
            f"filter the catalog of {size}: {filtered:.3f} CPU s, {chosen():,} chosen (target < 0.1); all its columns "
            f"are read in {whole:.3f}",
        ),
    ]


def scan_set(root: Path, size_gb: float) -> Path:
    """Return a dataset of at least so many GB on the disk; one that is there is added to."""
    create_dataset(root, exist_ok=True)
    batch = min(4096, int(size_gb * 1e9 / 40e3))
    while bytes_of(root) < size_gb * 1e9:
        first = len(open_dataset(root)) if version_path(root, 1).is_file() else 0
        append(root, episodes(batch, first), Lineage(operation="benchmark"), PER_PART)
    return root


def bytes_of(folder: Path) -> int:
    """Return the bytes of all files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def scan(root: Path) -> None:
    """Read every episode, and print how many, the bytes decoded, CPU seconds and peak memory [MB]."""
    begin, count, read = time.process_time(), 0, 0
    for episode in open_dataset(root):
        count, read = count + 1, read + sum(array.nbytes for array in episode.arrays.values())
    print(count, read, time.process_time() - begin, peak_mb())


def peak_mb() -> float:
    """Return this process's peak memory [MB]; Linux's ru_maxrss would count that of the parent before exec too."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1.024e-3
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def memory(root: Path, size_gb: float) -> list[Row]:
    """Measure the peak memory of a process that reads everything."""
    scan_set(root, size_gb)
    done = subprocess.run([sys.executable, __file__, "--scan", str(root)], check=True, capture_output=True, text=True)
    count, read, spent, peak = map(float, done.stdout.split())
    return [
        Row(
            peak < 500,
            f"full scan of {bytes_of(root) / 1e9:.2f} GB ({read / 1e9:.2f} GB decoded): peak memory {peak:.0f} MB "
            f"(target < 500 of 4 GB); {count / spent:,.0f} episodes per core-second, every content hash checked",
        )
    ]


def kills(folder: Path, count: int) -> list[Row]:
    """Measure what is lost when writers are killed."""
    folder.mkdir()
    done = kill_test(folder, kills=count)
    return [
        Row(
            done.has_passed,
            f"{done.lost} of {done.acknowledged} acknowledged episodes lost, {done.doubled} doubled, "
            f"{len(done.damage)} files damaged under {done.kills} kills with 3 writers (target 0)",
        )
    ]


def main() -> None:
    """Print each figure beside its target."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, help="folder that keeps what was made; else a temporary one")
    parser.add_argument("--size", type=float, default=4.0, help="GB on the disk of the set that is scanned")
    parser.add_argument("--episodes", type=int, default=768, help="episodes written in a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--kills", type=int, default=12)
    parser.add_argument("--scan", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.scan:
        scan(args.scan)
        return
    if args.scratch:
        args.scratch.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=args.scratch) as name:
        fresh, kept = Path(name), args.scratch or Path(name)
        rows = [
            *writing(fresh, args.episodes, args.rounds),
            *catalogs(kept / "catalog-100k", args.rounds),
            *memory(kept / f"scan-{args.size:g}gb", args.size),
            *kills(fresh / "kills", args.kills),
        ]
    for row in sorted(rows, key=lambda row: row.met):
        print(f"{'ok    ' if row.met else 'MISSED'}  {row.text}")


if __name__ == "__main__":
    main()
