"""A writer killed at any moment loses nothing that was acknowledged, with two more writing."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from candata.checks import check
from candata.datasets import content_hash, create_dataset, open_dataset, pending_parts

WORKER = Path(__file__).with_name("kill_worker.py")
KILLS = 12
PATIENCE_S = 20.0


class Writer:
    """A worker process and the file of its acknowledgements."""

    def __init__(self, root: Path, log: Path):
        self.log = log
        with log.open("wb") as sink:
            command = [sys.executable, str(WORKER), str(root), log.name]
            self.process = subprocess.Popen(command, stdout=sink)

    def acknowledged(self) -> dict[str, str]:
        lines = self.log.read_text().splitlines(keepends=True)
        return dict(line.split() for line in lines if line.endswith("\n"))

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


def wait_for_more(writer: Writer, count: int) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while len(writer.acknowledged()) < count:
        assert writer.process.poll() is None, "the writer ended by itself"
        assert time.monotonic() < deadline, "the writer acknowledges nothing"
        time.sleep(0.005)


def test_every_acknowledged_episode_is_found_once_and_intact(tmp_path):
    rng = random.Random(0)
    root = create_dataset(tmp_path / "ds")
    running = [Writer(root, tmp_path / f"w{i}") for i in range(3)]
    gone: list[Writer] = []
    try:
        for kill in range(KILLS):
            victim = running.pop(0)
            wait_for_more(victim, rng.randint(2, 6))
            time.sleep(rng.uniform(0, 0.05))
            victim.kill()
            gone.append(victim)
            running.append(Writer(root, tmp_path / f"r{kill}"))
        wait_for_more(running[0], 2)
    finally:
        for writer in running:
            writer.kill()
    acknowledged = {k: v for writer in gone + running for k, v in writer.acknowledged().items()}
    assert len(acknowledged) >= 2 * KILLS

    dataset = open_dataset(root)
    found = {episode.meta.id: content_hash(episode) for episode in dataset}
    assert {name: found.get(name) for name in acknowledged} == acknowledged
    listed = Counter(name for part in dataset.raw_parts() for name, _ in part.manifest().episodes)
    assert set(listed.values()) == {1}
    assert check(dataset) == ()
    assert len(pending_parts(root)) <= KILLS + 3  # written but not published, at most one a killed writer
