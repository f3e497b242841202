"""Commands that write, killed at chosen moments: what is lost, and whether the same command goes on; target 0 lost.

    python benchmarks/kills.py --kills 200 --out out/kills          # goes on where it was stopped

Every command runs in a process of its own in a fresh copy of one folder and is killed (SIGKILL) right before or after
the k-th call by which it changes files: opened to write, synced, named, removed. A fifth of the kills come at any time
instead. Then everything that stood before must stand with the same contents, and the same command, run again, must end
as one that was never killed: with the same episodes, weights, tags or report. The kills of a command go through its
calls evenly, those that give names (rename, link) three times as often.

`start` counts kills before the first such call, `publish` those at a call that gives a name, `middle` the others.
"""

from __future__ import annotations

import argparse
import builtins
import importlib
import io
import json
import mmap
import os
import random
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from killed.commands import Command, Words, commands, lost, run, standing
from killed.commands import prepare as begin

#: Modules that are loaded once: each process is forked from this one.
LOADED = (
    *("candata_cli.main", "pyarrow.parquet", "zarr", "mujoco", "torch", "safetensors.torch", "duckdb"),
    *("mcap.writer", "google.protobuf.message", "scipy.optimize", "yaml", "candata.datasets", "candata.record.logs"),
)
#: Calls of `os` by which files change, and those of them that give a name.
CALLS = ("rename", "replace", "link", "unlink", "rmdir", "mkdir", "fsync", "ftruncate")
NAMING = CALLS[:3]
#: Share of the kills that come at any time.
TIMED = 0.2


class Moment(NamedTuple):
    """When to kill: before or after the call of this number, or after so many seconds."""

    call: int = -1
    after: bool = False
    seconds: float | None = None


def forked(folder: Path, work: Callable[[], Any], log: Path | None = None) -> tuple[int, Callable[[], Any]]:
    """Start a process that works in a folder; return its number, and what gives its result as plain data."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(reading)
        code = 70
        try:
            os.setsid()
            os.chdir(folder)
            os.environ["CANDATA_REGISTRY"] = str(folder / "registry.json")
            sink = os.open(log or os.devnull, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
            os.dup2(sink, 1)
            os.dup2(sink, 2)
            value = work()
            with os.fdopen(writing, "w") as pipe:
                json.dump(value, pipe)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(writing)

    def result() -> Any:
        with os.fdopen(reading) as pipe:
            text = pipe.read()
        os.waitpid(pid, 0)
        return json.loads(text) if text else None

    return pid, result


def told(folder: Path, work: Callable[[], Any], log: Path | None = None) -> Any:
    """Return what a process of its own finds in a folder."""
    return forked(folder, work, log)[1]()


class Calls:
    """Counts the calls by which this process changes files in memory that its parent sees; kills it at one of them."""

    def __init__(self, moment: Moment, shared: mmap.mmap, trace: list[str]) -> None:
        self.moment, self.shared, self.trace, self.count = moment, shared, trace, 0

    def watch(self) -> None:
        """Put themselves in the place of the calls."""
        for name in CALLS:
            setattr(os, name, self._counted(getattr(os, name), name))
        opened = self._counted(builtins.open, "open")
        builtins.open = io.open = lambda *a, **k: (opened if writes(*a, **k) else _OPEN)(*a, **k)  # type: ignore[assignment]

    def _counted(self, call: Callable[..., Any], name: str) -> Callable[..., Any]:
        def counted(*words: Any, **more: Any) -> Any:
            number, self.count = self.count, self.count + 1
            self.trace.append(name)
            self._note(number, name)
            if number == self.moment.call and not self.moment.after:
                os.kill(os.getpid(), signal.SIGKILL)
            value = call(*words, **more)
            if number == self.moment.call:
                os.kill(os.getpid(), signal.SIGKILL)
            return value

        return counted

    def _note(self, number: int, name: str) -> None:
        self.shared[:8] = struct.pack("<ii", number + 1, name in NAMING)


_OPEN = builtins.open


def writes(file: Any, mode: str = "r", *_: Any, **more: Any) -> bool:
    """Tell whether a call of open may change a file."""
    return isinstance(file, str | os.PathLike) and bool(set(more.get("mode", mode)) & set("wax+"))


def watched(words: Words, moment: Moment, shared: mmap.mmap) -> dict[str, Any]:
    """Run a command whose calls are counted; return its exit code and the calls."""
    trace: list[str] = []
    Calls(moment, shared, trace).watch()
    began = time.monotonic()
    return {"code": run(words), "trace": trace, "seconds": time.monotonic() - began}


def write_registry(folder: Path) -> None:
    """Write the registry of a folder: the name of a dataset and three remotes in it."""
    remotes = {"lab": "share", "store": "store", "spare": "share"}
    entries = {name: {"url": str(folder / place)} for name, place in remotes.items()}
    whole = {"registry_version": 1, "datasets": {"spare": str(folder / "other")}, "remotes": entries}
    (folder / "registry.json").write_text(json.dumps(whole))


def prepare(template: Path) -> None:
    """Make the folder that all commands begin in."""
    template.mkdir()
    write_registry(template)
    if told(template, begin, template.parent / "prepare.log") is None:
        raise SystemExit((template.parent / "prepare.log").read_text())


class Golden(NamedTuple):
    """A run that is not killed: what it made, its calls, how long it took."""

    made: Any
    trace: list[str]
    seconds: float


def golden(command: Command, template: Path, scratch: Path) -> Golden:
    """Return what a command makes when nobody kills it."""
    folder = shutil.copytree(template, scratch / "golden", symlinks=True)
    write_registry(folder)
    done = told(folder, lambda: watched(command.words, Moment(), mmap.mmap(-1, 8)), scratch / "golden.log")
    if done is None or done["code"] != 0:
        raise SystemExit(f"{command.name} fails by itself:\n{(scratch / 'golden.log').read_text()}")
    made = told(folder, command.made)
    shutil.rmtree(folder)
    return Golden(made, done["trace"], done["seconds"])


def moments(whole: Golden, count: int, rng: random.Random) -> list[Moment]:
    """Return when to kill: evenly over the calls, those that give a name three times, and some at any time."""
    places = [(i, after) for i, name in enumerate(whole.trace) for after in (False, True) for _ in range(_often(name))]
    timed = round(TIMED * count)
    step = len(places) / max(1, count - timed)
    offset = rng.random()
    chosen = [places[int((i + offset) * step) % len(places)] for i in range(count - timed)]
    at_call = [Moment(call, after) for call, after in chosen]
    return at_call + [Moment(seconds=rng.uniform(0, whole.seconds)) for _ in range(timed)]


def _often(name: str) -> int:
    return 3 if name in NAMING else 1


def kill(command: Command, whole: Golden, moment: Moment, template: Path, scratch: Path) -> dict[str, Any]:
    """Return where a kill hit, what it lost and whether the command went on."""
    folder, log, shared = scratch / "trial", scratch / "trial.log", mmap.mmap(-1, 8)
    shutil.rmtree(folder, ignore_errors=True)
    log.unlink(missing_ok=True)
    shutil.copytree(template, folder, symlinks=True)
    write_registry(folder)
    before = told(folder, standing)
    pid, result = forked(folder, lambda: watched(command.words, moment, shared), log)
    if moment.seconds is not None:
        time.sleep(moment.seconds)
        os.kill(pid, signal.SIGKILL)
    ended = result() is not None
    calls, naming = struct.unpack("<ii", shared[:8])
    hit = "start" if calls == 0 or moment == Moment(0) else "publish" if naming else "middle"
    missing = lost(before, told(folder, standing, log))
    if told(folder, command.made, log) != whole.made:
        code = told(folder, lambda: run(command.words), log)
        missing += [f"exit {code} when run again"] if code != 0 else []
    after = told(folder, command.made, log)
    missing += [] if after == whole.made else ["another result when run again"]
    missing += lost(before, told(folder, standing, log))
    if missing:
        shutil.copy(log, scratch / f"lost-{command.name.replace(' ', '-')}-{calls}.log")
    return {"command": command.name, "hit": "end" if ended else hit, "lost": missing, "calls": calls}


def count_of(command: Command, kills: int, chosen: list[Command]) -> int:
    """Return how often a command is killed, of so many kills in all; at least once."""
    return max(1, round(kills * command.weight / sum(one.weight for one in chosen)))


def table(lines: list[dict[str, Any]]) -> str:
    """Return kills by command and by where they hit, and what was lost."""
    hits = ("start", "middle", "publish", "end")
    rows = [("command", *hits, "kills", "lost")]
    for name in dict.fromkeys(line["command"] for line in lines):
        own = [line for line in lines if line["command"] == name]
        counts = [sum(line["hit"] == hit for line in own) for hit in hits]
        rows.append((name, *map(str, counts), str(len(own)), str(sum(bool(line["lost"]) for line in own))))
    totals = [str(sum(int(row[i]) for row in rows[1:])) for i in range(1, len(rows[0]))]
    rows.append(("all", *totals))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    )


def main(arguments: list[str] | None = None) -> int:
    """Kill, print the table; return 1 where anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=63, help="kills in all, those of an earlier run included")
    parser.add_argument("--seed", type=int, default=1, help="draws the moments")
    parser.add_argument("--only", default="", help="commands, comma separated (default: all)")
    parser.add_argument("--out", type=Path, help="folder of the results: a run that was stopped goes on")
    args = parser.parse_args(arguments)
    chosen = [one for one in commands() if not args.only or one.name in args.only.split(",")]
    for module in LOADED:
        importlib.import_module(module)
    with tempfile.TemporaryDirectory() as name:
        scratch, out = Path(name), args.out or Path(name, "out")
        out.mkdir(parents=True, exist_ok=True)
        prepare(scratch / "template")
        log = out / "kills.jsonl"
        lines = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
        for command in chosen:
            count, done = count_of(command, args.kills, chosen), sum(one["command"] == command.name for one in lines)
            if done >= count:
                continue
            whole = golden(command, scratch / "template", scratch)
            times = moments(whole, count, random.Random(f"{args.seed} {command.name}"))
            for moment in times[done:]:
                lines.append(kill(command, whole, moment, scratch / "template", scratch))
                with log.open("a") as file:
                    file.write(json.dumps(lines[-1]) + "\n")
                for text in lines[-1]["lost"]:
                    print(f"LOST {command.name}, {moment}: {text}", file=sys.stderr)
            for path in scratch.glob("lost-*"):
                shutil.move(path, out / path.name)
    print(table(lines))
    bad = sum(bool(line["lost"]) for line in lines)
    print(f"{'ok  ' if not bad else 'MISS'} lost in {len(lines)} kills: {bad} (target 0)")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
