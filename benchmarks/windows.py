"""Windows per core-second, candata's loaders beside those of others in one run, and what opening the cache costs.

    python benchmarks/windows.py [--lerobot PYTHON] [--diffusion-policy REPOSITORY [--diffusion-policy-python PYTHON]]

300 episodes of 300 steps (pose 7, joints 19, actions 19, forces 5 x 3 float32, contact 5 bool), windows of 20 rows
(10 + 10), batches of 256 in random order. Rounds take turns, so that a busy machine slows all alike; time is CPU time
of all processes of a loader, on one thread each. Needs the extra `train`.

Others read what `candata export` writes of the same data, each in its own environment: PYTHON is an interpreter with
lerobot (or with what Diffusion Policy asks for, and torch), REPOSITORY a clone of real-stanford/diffusion_policy. What
is not given, or does not run, is said to be missing. The first windows of all loaders are compared, value by value.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from candata.datasets import append, create_dataset, open_dataset
from candata.loaders import Feed, Windows, as_tensors, mix, windows
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

JOINTS, FINGERTIPS, BATCH, HISTORY, WINDOW = 19, 5, 256, 10, 20
LOADER_TARGET, DIRECT_TARGET, OPEN_TARGET_S = 250_000, 500_000, 0.1
OTHERS = Path(__file__).with_name("others")
#: Windows that are compared between loaders.
COMPARED = 8


def episodes(count: int, rows: int) -> Iterable[Episode]:
    """Yield synthetic episodes with the channels of a hand."""
    rng = np.random.default_rng(0)
    joints, tips = tuple(f"j{i}" for i in range(JOINTS)), tuple(f"f{i}" for i in range(FINGERTIPS))
    for number in range(count):
        quaternion = rng.normal(size=(rows, 4))
        arrays = {
            "time_ns": np.arange(rows) * 12_500_000,
            "object_pose": np.c_[rng.normal(size=(rows, 3)), quaternion / np.linalg.norm(quaternion, axis=1)[:, None]],
            "joint_position": rng.normal(size=(rows, JOINTS)),
            "action": rng.normal(size=(rows, JOINTS)),
            "fingertip_force": rng.normal(size=(rows, FINGERTIPS, 3)),
            "fingertip_contact": rng.random((rows, FINGERTIPS)) < 0.5,
        }
        named = {"joint_names": joints, "actuator_names": joints, "fingertip_names": tips}
        yield Episode(EpisodeMeta(id=f"e{number:04d}", source="sim", rate_hz=80, **named), arrays)


class ItemByItem(Dataset):
    """The plain way: arrays in memory, one window sliced at a time, batches stacked by torch."""

    def __init__(self, source: Iterable[Episode]):
        """Hold the arrays."""
        self.arrays: list[Mapping[str, np.ndarray]] = [
            {name: values for name, values in episode.arrays.items() if name != "time_ns"} for episode in source
        ]
        self.windows = len(self.arrays[0]["action"]) - WINDOW + 1

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.arrays) * self.windows

    def __getitem__(self, number: int) -> dict[str, torch.Tensor]:
        """Return one window."""
        episode, first = divmod(number, self.windows)
        return {n: torch.from_numpy(v[first : first + WINDOW].copy()) for n, v in self.arrays[episode].items()}


class Other:
    """A foreign loader in its own process."""

    def __init__(self, command: list[str], paths: str = ""):
        """Start it and wait until its data is open; raise RuntimeError when it does not run."""
        environment = os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}
        with tempfile.TemporaryFile("w+") as errors:
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
            self.process = subprocess.Popen(command, text=True, env=environment, **pipes)
            told = self.process.stdout.readline()
            if not told:
                self.process.communicate()
                errors.seek(0)
                raise RuntimeError((errors.read().strip().splitlines() or ["it ended without a word"])[-1])
        self.facts = json.loads(told)

    def ask(self, **question: object) -> dict:
        """Return the answer to a question."""
        self.process.stdin.write(json.dumps(question) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def __enter__(self) -> Other:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self.process.communicate()


def used_s() -> float:
    """Return the CPU seconds of this process and of the workers that have ended."""
    parts = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(part.ru_utime + part.ru_stime for part in parts)


def rate(batches: Iterable, count: int) -> float:
    """Return windows per CPU second of going through `count` batches."""
    begin = used_s()
    for _ in batches:
        pass
    return count * BATCH / (used_s() - begin)


def through_loader(feed: Feed, count: int, workers: int = 0) -> float:
    """Return windows per CPU second of a DataLoader in the order of a Sampler."""
    steps = feed.sampler(BATCH).steps(0, count)
    loader = DataLoader(feed, batch_sampler=steps, collate_fn=dict if workers else as_tensors, num_workers=workers)
    return rate(map(as_tensors, loader) if workers else loader, count)


def item_by_item(plain: ItemByItem, count: int) -> float:
    """Return windows per CPU second of the plain way."""
    order = np.random.default_rng(0).permutation(len(plain))[: count * BATCH].tolist()
    return rate(DataLoader(plain, batch_size=BATCH, sampler=order), count)


def direct(source: Feed, feed: Feed, count: int) -> float:
    """Return windows per CPU second of `source.batch` in the order of a Sampler."""
    sampler = feed.sampler(BATCH)
    sampler.indices(0)
    return rate((source.batch(sampler.indices(step)) for step in range(count)), count)


def differing(other: Other, way: str, feed: Windows, rows: int) -> int:
    """Return how many values of a few windows differ between a foreign loader and candata."""
    numbers = np.random.default_rng(1).permutation(len(feed))[:COMPARED]
    mine = feed.batch(numbers)
    places = [[int(e), int(r) - HISTORY + 1] for e, r in zip(mine["episode"], mine["row"], strict=True)]
    found = other.ask(do="values", way=way, windows=places)["values"]
    count = 0
    for name in feed.channels:
        expected = np.concatenate([mine[f"history/{name}"], mine[f"future/{name}"]], axis=1).reshape(
            COMPARED, WINDOW, -1
        )
        count += int((np.concatenate([np.array(batch[name]) for batch in found]) != expected).sum())
    return count


def start_others(args: argparse.Namespace, root: Path, stack: ExitStack) -> dict[str, Other | str]:
    """Return each foreign loader, or why it is missing."""
    sizes = [str(n) for n in (args.rows, HISTORY, WINDOW, BATCH)]
    repository = args.diffusion_policy
    wanted: dict[str, tuple[str, str, list[str], str] | str] = {
        "LeRobot": "not asked for: --lerobot PYTHON",
        "Diffusion Policy": "not asked for: --diffusion-policy REPOSITORY",
    }
    if args.lerobot:
        wanted["LeRobot"] = ("lerobot", "", [args.lerobot, str(OTHERS / "lerobot_side.py")], "")
    if repository:
        script = [args.diffusion_policy_python, str(OTHERS / "diffusion_policy_side.py")]
        wanted["Diffusion Policy"] = ("diffusion_policy", "replay_buffer.zarr", script, str(repository))
    found: dict[str, Other | str] = {}
    for name, asked in wanted.items():
        if isinstance(asked, str):
            found[name] = asked
            continue
        export, inside, command, paths = asked
        out = root.with_name(export)
        words = [sys.executable, "-m", "candata_cli.main", "export", export, str(root), "--out", str(out)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        try:
            if done.returncode:
                raise RuntimeError(done.stderr.strip().splitlines()[0])
            found[name] = stack.enter_context(Other([*command, str(out / inside), *sizes], paths))
        except (OSError, RuntimeError) as error:
            found[name] = f"not measured: {error}"
    return found


def measure(args: argparse.Namespace, root: Path, others: Mapping[str, Other | str]) -> dict[str, list[float]]:
    """Return windows per CPU second of each way, by round; the ways take turns."""
    dataset, shape = open_dataset(root), {"history": HISTORY, "horizon": WINDOW - HISTORY, "stride": 1, "pad": "none"}
    feed, plain = windows(dataset, **shape), ItemByItem(episodes(args.episodes, args.rows))
    mixed = mix({"sim": feed, "real": windows(dataset, **shape)}, "sim:0.7,real:0.3")
    resident, many = feed.resident("cpu"), len(feed) // BATCH
    ways: dict[str, Callable[[int], float]] = {
        "candata, DataLoader": lambda _: through_loader(feed, many),
        "candata, direct": lambda _: direct(feed, feed, many),
        "candata, resident torch": lambda _: direct(resident, feed, many),
        "candata, mixture of two, direct": lambda _: direct(mixed, mixed, many),
        "candata, DataLoader, 2 workers": lambda _: through_loader(feed, many, 2),
        "item by item in memory, DataLoader": lambda _: item_by_item(plain, 20),
    }
    for name, other in others.items():
        if isinstance(other, str):
            continue
        for way in other.facts["ways"]:
            count = 2 if name == "LeRobot" else 20

            def foreign(number: int, other: Other = other, way: str = way, count: int = count) -> float:
                numbers = np.random.default_rng(number).permutation(len(feed))[: count * BATCH]
                mine = feed.batch(numbers)
                places = [[int(e), int(r) - HISTORY + 1] for e, r in zip(mine["episode"], mine["row"], strict=True)]
                return count * BATCH / other.ask(do="time", way=way, windows=places)["cpu_s"]

            ways[f"{other.facts['name']}, {way}"] = foreign
            print(
                f"{other.facts['name']}, {way}: {differing(other, way, feed, args.rows)} values of "
                f"{COMPARED} windows differ from candata's"
            )
    results: dict[str, list[float]] = {name: [] for name in (*ways, "open")}
    for number in range(args.rounds):
        begin = time.process_time()
        windows(dataset, **shape)
        results["open"].append(time.process_time() - begin)
        for name, way in ways.items():
            results[name].append(way(number))
    return results


def report(results: Mapping[str, list[float]], others: Mapping[str, Other | str]) -> None:
    """Print each figure beside its target, what misses it first."""
    middle = {name: float(np.median(values)) for name, values in results.items()}
    opened = middle.pop("open")
    lines = [(opened > OPEN_TARGET_S, f"open: {opened:.3f} CPU s (target < {OPEN_TARGET_S})")]
    targets = {"candata, DataLoader": LOADER_TARGET, "candata, direct": DIRECT_TARGET}
    for name, value in middle.items():
        target = targets.get(name)
        against = f" (target >= {target:,})" if target else ""
        times = middle["candata, DataLoader"] / value
        ratio = "" if name.startswith("candata") else f"; candata's DataLoader gives {times:,.0f} x as many"
        lines.append((bool(target and value < target), f"{name}: {value:,.0f} windows per core-second{against}{ratio}"))
    for missed, line in sorted(lines, key=lambda one: not one[0]):
        print(("MISSED " if missed else "") + line)
    for name, other in others.items():
        if isinstance(other, str):
            print(f"{name}: {other}")


def main() -> None:
    """Make the data, measure all ways in turn, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--rows", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--lerobot", metavar="PYTHON", help="interpreter with lerobot")
    parser.add_argument("--diffusion-policy", metavar="REPOSITORY", type=Path, help="clone of its repository")
    parser.add_argument("--diffusion-policy-python", metavar="PYTHON", default=sys.executable)
    args = parser.parse_args()
    print("to run it again: python " + " ".join(sys.argv))
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        root = create_dataset(Path(folder) / "ds")
        append(root, episodes(args.episodes, args.rows), Lineage(operation="benchmark"))
        begin = time.process_time()
        windows(root, HISTORY, WINDOW - HISTORY, stride=1)
        print(f"making the cache: {time.process_time() - begin:.2f} CPU s")
        others = start_others(args, root, stack)
        report(measure(args, root, others), others)


if __name__ == "__main__":
    main()
