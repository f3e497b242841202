"""Mutated inputs read one by one: what came of each, in a process of its own within bounds of memory and time."""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from candata.errors import CandataError
from tests.mutated.mutations import mutated
from tests.mutated.readers import READERS, Reader

ROOT = Path(__file__).resolve().parents[2]
#: What one input may take: memory beyond that of the process with all modules loaded [bytes], and time [s].
MOST_BYTES, MOST_S = 2**30, 30.0
#: What came of an input, a byte each in a reader's file of outcomes.
READ, REFUSED, WRONG, CRASHED, LATE = b"r", b"e", b"w", b"c", b"t"
#: Rows of the sound files, and of those that are spliced into them.
_ROWS, _OTHER_ROWS = 4, 3


class Sources(NamedTuple):
    """The sound files of a reader by path, those that are mutated, files to splice, and what is read of sound ones."""

    files: Mapping[str, bytes]
    targets: Sequence[str]
    others: Mapping[str, Sequence[bytes]]
    contents: Any


def sources(reader: Reader, folder: Path) -> Sources:
    """Return the sound files of a reader, written below `folder`."""
    files, other = (_written(reader, folder / str(rows), rows) for rows in (_ROWS, _OTHER_ROWS))
    targets = [name for name in files if (folder / str(_ROWS) / name) in set((folder / str(_ROWS)).glob(reader.files))]
    kinds = {name: [data for path, data in [*other.items(), *files.items()] if _alike(path, name)] for name in targets}
    return Sources(files, targets, kinds, reader.read(folder / str(_ROWS)) if reader.whole else None)


def _written(reader: Reader, folder: Path, rows: int) -> dict[str, bytes]:
    """Return the sound files that a reader is given."""
    folder.mkdir(parents=True)
    reader.write(folder, rows)
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def _alike(path: str, other: str) -> bool:
    """Tell whether two files are of one kind, by their endings."""
    return Path(path).suffix == Path(other).suffix


def lay_input(made: Sources, folder: Path, key: str) -> None:
    """Write the files of one input, one of them mutated; the same key gives the same bytes."""
    rng = random.Random(key)
    target = rng.choice(made.targets)
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in made.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if name != target:
            path.write_bytes(data)
        elif rng.random() > 0.01:  # else it is missing
            path.write_bytes(mutated(data, made.others[name], rng))


def outcome(reader: Reader, made: Sources, folder: Path) -> tuple[bytes, str]:
    """Return what came of the input in a folder, and what is wrong with that."""
    try:
        contents = reader.read(folder)
    except CandataError:
        return REFUSED, ""
    except Exception:
        return WRONG, traceback.format_exc()
    there = all((folder / name).is_file() for name in made.files)  # without its hashes a set is as any other's
    if reader.whole and there and contents != made.contents:
        return WRONG, f"other contents: {contents!r}"[:2000]
    return READ, ""


def serve(name: str, seed: int, until: int, out: Path) -> None:
    """Read the inputs of one reader that were not yet read, up to number `until`; write what came of each.

    `NAME.outcomes` holds a byte an input; `NAME.jsonl` the failures, and which input took most.
    """
    reader = READERS[name]
    warnings.simplefilter("error")
    os.environ["XDG_CACHE_HOME"] = str(out / "cache")
    with tempfile.TemporaryDirectory() as home:
        made = sources(reader, Path(home, "sound"))
        address_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (address_bytes + MOST_BYTES, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        most = {"peak_bytes": 0.0, "seconds": 0.0}
        with open(out / f"{name}.outcomes", "ab") as outcomes, open(out / f"{name}.jsonl", "a") as facts:
            for number in range(outcomes.tell(), until):
                key = f"{seed}/{name}/{number}"
                lay_input(made, Path(home, "input"), key)
                Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
                before, begin = _peak_bytes(), time.perf_counter()
                signal.setitimer(signal.ITIMER_REAL, MOST_S)  # the process ends, whatever it is in
                found, words = outcome(reader, made, Path(home, "input"))
                signal.setitimer(signal.ITIMER_REAL, 0)
                took = {"seconds": time.perf_counter() - begin, "peak_bytes": float(_peak_bytes() - before)}
                if words:
                    facts.write(json.dumps({"failure": key, "words": words}) + "\n")
                for fact in [fact for fact, value in took.items() if value > most[fact]]:
                    most[fact] = took[fact]
                    facts.write(json.dumps({fact: took[fact], "input": key}) + "\n")
                facts.flush()
                outcomes.write(found)
                outcomes.flush()


def _peak_bytes() -> int:
    """Return the most memory that this process held since its peak was set back."""
    (line,) = [x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("VmHWM")]
    return int(line.split()[1]) * 1024


def run_readers(names: Sequence[str], seed: int, until: int, out: Path) -> None:
    """Read the inputs of some readers up to number `until`, in a process that is begun anew where it crashed.

    Raises
    ------
    RuntimeError
        When the process ends for another reason than an input.
    """
    out.mkdir(parents=True, exist_ok=True)
    code = "import sys; from pathlib import Path; from tests.mutated.running import serve\n"
    code += "for name in sys.argv[4:]: serve(name, int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))"
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
    while unfinished := [name for name in names if _done(name, out) < until]:
        words = [sys.executable, "-c", code, str(seed), str(until), str(out.resolve()), *unfinished]
        ran = subprocess.run(words, cwd=ROOT, env=os.environ | threads, capture_output=True, text=True, check=False)
        at_fault = next((name for name in unfinished if _done(name, out) < until), None)
        if at_fault is None:
            return
        key = f"{seed}/{at_fault}/{_done(at_fault, out)}"
        if ran.returncode >= 0:
            raise RuntimeError(f"{key}: the process ended with {ran.returncode}\n{ran.stderr[-3000:]}")
        with (out / f"{at_fault}.outcomes").open("ab") as outcomes, (out / f"{at_fault}.jsonl").open("a") as facts:
            outcomes.write(LATE if ran.returncode == -signal.SIGALRM else CRASHED)
            said = f"ended by signal {-ran.returncode}: {ran.stderr[-2000:]}"
            facts.write(json.dumps({"failure": key, "words": said}) + "\n")


def _done(name: str, out: Path) -> int:
    """Return how many inputs of a reader were read."""
    path = out / f"{name}.outcomes"
    return path.stat().st_size if path.exists() else 0


class Tally(NamedTuple):
    """What came of a reader's inputs: how many of each outcome, the failures, the most memory and time."""

    counts: Counter[str]
    failures: Sequence[tuple[str, str]]
    peak_bytes: float
    seconds: float


def tally(name: str, out: Path) -> Tally:
    """Return what came of the inputs of a reader so far."""
    counts = Counter(chr(byte) for byte in (out / f"{name}.outcomes").read_bytes())
    facts = [json.loads(line) for line in (out / f"{name}.jsonl").read_text().splitlines()]
    failures = [(fact["failure"], fact["words"]) for fact in facts if "failure" in fact]
    most = {key: max((fact[key] for fact in facts if key in fact), default=0.0) for key in ("peak_bytes", "seconds")}
    return Tally(counts, failures, most["peak_bytes"], most["seconds"])
