"""The kill test: processes that write are killed at any moment; what they had acknowledged must be there.

`python -m candata.datasets.kill_test FOLDER ROLE NAME [GRACE_S]` is one such process.
"""

from __future__ import annotations

import itertools
import os
import random
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from candata.datasets.adding import append
from candata.datasets.compact import compact_dataset
from candata.datasets.dataset import open_dataset
from candata.datasets.encode import content_hash
from candata.datasets.gc import collect_garbage
from candata.datasets.versions import create_dataset
from candata.errors import CandataError, DataError, SetupError, Where
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

#: Longest wait for one acknowledgement [s]; a share far away needs some tenths of a second.
PATIENCE_S = 60.0
#: How often an episode is written before its writer gives up.
_TRIES = 20


@dataclass(frozen=True)
class KillResult:
    """What was acknowledged and what was found.

    Attributes
    ----------
    kills : int
        Processes killed, not counting the end.
    acknowledged : int
        Episodes that a writer said were published.
    lost : int
        Acknowledged episodes that are missing or changed.
    doubled : int
        Episodes that lie in more than one part of the newest version.
    damage : tuple of str
        Files that are not what was written.
    versions : int
        Number of the newest version.
    """

    kills: int
    acknowledged: int
    lost: int
    doubled: int
    damage: tuple[str, ...]
    versions: int

    @property
    def has_passed(self) -> bool:
        """Whether nothing was lost, doubled or damaged."""
        return self.acknowledged > 0 and not (self.lost or self.doubled or self.damage)


class _Process:
    """A process with a role, and the file of its acknowledgements."""

    def __init__(self, root: Path, role: str, log: Path, grace_s: float):
        self.role, self.log, self.errors = role, log, log.with_suffix(".err")
        command = [sys.executable, "-m", __name__, str(root), role, log.stem, str(grace_s)]
        with log.open("wb") as sink, self.errors.open("wb") as errors:
            self.process = subprocess.Popen(command, stdout=sink, stderr=errors)

    def acknowledged(self) -> dict[str, str]:
        """Return episode id to content hash of each whole line."""
        lines = self.log.read_text().splitlines(keepends=True)
        return dict(line.split() for line in lines if line.endswith("\n"))

    def kill(self) -> None:
        """End it at once, without asking."""
        self.process.kill()
        self.process.wait()

    def wait_for(self, count: int) -> None:
        """Wait until it has acknowledged so much.

        Raises
        ------
        SetupError
            When it ends by itself, or acknowledges nothing for too long.
        """
        deadline = time.monotonic() + PATIENCE_S
        while len(self.acknowledged()) < count:
            has_ended = self.process.poll() is not None
            if has_ended or time.monotonic() > deadline:
                error_text = "; ".join(line.strip() for line in self.errors.read_text().splitlines()[-6:]) or "nothing"
                raise SetupError(
                    f"a process of the kill test ({self.role}) {'ended by itself' if has_ended else 'does not go on'}",
                    expected=f"{count} acknowledgements within {PATIENCE_S:g} s",
                    found=f"{len(self.acknowledged())}; it said: {error_text}",
                    where=Where(path=str(self.log.parent)),
                )
            time.sleep(0.005)


def kill_test(
    folder: Path,
    *,
    kills: int = 12,
    roles: Sequence[str] = ("append", "append", "append"),
    grace_s: float = 5.0,
    seed: int = 0,
    progress: Callable[[int], None] = lambda done_count: None,
) -> KillResult:
    """Return what is left of a scratch dataset whose writers are killed again and again, others writing on.

    Parameters
    ----------
    folder : Path
        Existing folder; the dataset and the logs are made in it and stay.
    kills : int
        How often a process is killed and another one started in its place.
    roles : sequence of str
        What runs at once: `append`, `compact` or `collect` each.
    grace_s : float
        Grace period [s] of the garbage collection.
    seed : int
        Seed of the moments of the kills.
    progress : callable
        Called with the number of kills so far.

    Raises
    ------
    SetupError
        When a process ends by itself, or the folder cannot be written.
    """
    rng = random.Random(seed)
    root = create_dataset(folder / "dataset")
    counter = itertools.count()

    def start(role: str) -> _Process:
        return _Process(root, role, folder / f"{role}{next(counter)}.log", grace_s)

    processes, victims = [start(role) for role in roles], []
    try:
        for kill in range(kills):
            victim = processes.pop(0)
            victim.wait_for(rng.randint(2, 6) if victim.role == "append" else 1)
            time.sleep(rng.uniform(0, 0.05))
            victim.kill()
            victims.append(victim)
            processes.append(start(victim.role))
            progress(kill + 1)
        for process in processes:
            process.wait_for(1)
    finally:
        for process in processes:
            process.kill()
    writers = [process for process in victims + processes if process.role == "append"]
    return _verdict(root, kills, {k: v for writer in writers for k, v in writer.acknowledged().items()})


def _verdict(root: Path, kills: int, expected_hashes: dict[str, str]) -> KillResult:
    """Return the result: the acknowledged episodes against those in the dataset."""
    dataset = open_dataset(root, partial=True)
    hashes, damage = {}, []
    for name in dataset.ids:
        try:
            hashes[name] = content_hash(dataset.episode(name))
        except DataError as error:
            damage.append(str(error.where))
    part_counts: Counter[str] = Counter()
    for part in dataset.raw_parts():
        try:
            manifest = part.manifest()
        except DataError as error:
            damage.append(str(error.where))
            continue
        part_counts.update(name for name, _ in manifest.episodes)
        problem = part.changed_file(manifest)
        damage += [str(problem.where)] if problem else []
    lost_count = sum(hashes.get(name) != digest for name, digest in expected_hashes.items())
    doubled_count = sum(count > 1 for count in part_counts.values())
    return KillResult(kills, len(expected_hashes), lost_count, doubled_count, tuple(damage), dataset.version)


def main(root: str, role: str, name: str, grace_s: str = "5") -> None:
    """Play a role until the parent is gone; write `id hash` once each piece of work is done."""
    parent = os.getppid()
    work = {"append": _append_loop, "compact": _compact_loop, "collect": _collect_loop}[role]
    for line in work(Path(root), name, float(grace_s)):
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
        if os.getppid() != parent:
            return


def _append_loop(root: Path, name: str, _grace_s: float) -> Iterator[str]:
    """Append episodes one by one; yield each one's id and hash once it is published."""
    rng = np.random.default_rng(list(name.encode()))
    for number in itertools.count():
        arrays = {"time_ns": np.arange(50) * 12_500_000, "joint_position": rng.normal(size=(50, 15))}
        episode = Episode(EpisodeMeta(id=f"{name}-{number:04d}", source="sim", rate_hz=80), arrays)
        for tries_left in range(_TRIES - 1, -1, -1):
            try:
                append(root, [episode], Lineage(operation="kill test"))
                break
            except (DataError, SetupError):  # a grace period shorter than the writing: its part was collected
                if not tries_left:
                    raise
        yield f"{episode.meta.id} {content_hash(episode)}"


def _compact_loop(root: Path, name: str, _grace_s: float) -> Iterator[str]:
    """Compact again and again; where others leave it no time, or there is nothing yet, try again."""
    for number in itertools.count():
        with suppress(CandataError):
            version = compact_dataset(root, limit=8).version
            yield f"{name}-{number:04d} {version.number}"
        time.sleep(0.02)


def _collect_loop(root: Path, name: str, grace_s: float) -> Iterator[str]:
    """Collect garbage again and again, keeping one version."""
    for number in itertools.count():
        yield f"{name}-{number:04d} {collect_garbage(root, grace_s=grace_s, keep=1).bytes}"
        time.sleep(0.05)


if __name__ == "__main__":
    main(*sys.argv[1:])
