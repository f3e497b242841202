"""Mutated inputs of every reader: only candata's errors, at most 1 GB of memory and 30 s each.

    python benchmarks/mutated_inputs.py --inputs 1000000 --jobs 2 --out out/mutated     # goes on where it was stopped
    python benchmarks/mutated_inputs.py --show 0/table_csv/17       # one input again, with its traceback

Sound files of each format, store and text that candata reads are mutated (bits, runs, cuts, splices, extreme lengths;
numbers, words, lines and nesting of text) and read, all readers alike, in processes of their own. Whatever is read must
have hashes that fit where hashes guard it; whatever is refused must be refused by an error of candata's. Printed for
each reader: inputs, read, refused, and what is neither, with the key that makes each again.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.mutated.readers import READERS
from tests.mutated.running import CRASHED, LATE, READ, REFUSED, WRONG, lay_input, outcome, run_readers, sources, tally

#: Inputs of a reader before the next one has its turn, so that all come equally far.
TURN = 200


def run(names: list[str], inputs: int, jobs: int, seed: int, out: Path) -> None:
    """Read the inputs of all readers, turn by turn."""
    each = -(-inputs // len(names))
    with ThreadPoolExecutor(jobs) as pool:
        for until in [*range(TURN, each, TURN), each]:
            list(pool.map(lambda name: run_readers([name], seed, min(until, each), out), names))  # noqa: B023


def show(key: str) -> None:
    """Read one input again and print what comes of it."""
    name = key.split("/")[1]
    with tempfile.TemporaryDirectory() as folder:
        made = sources(READERS[name], Path(folder, "sound"))
        lay_input(made, Path(folder, "input"), key)
        found, words = outcome(READERS[name], made, Path(folder, "input"))
        print(found.decode(), words)


def table(names: list[str], out: Path) -> int:
    """Print what came of all inputs and return how many were neither read nor refused."""
    wrong = total = 0
    print(f"{'reader':18}{'inputs':>9}{'read':>9}{'refused':>9}{'other':>7}{'peak MB':>9}{'slowest s':>11}")
    for name in (name for name in names if (out / f"{name}.outcomes").exists()):
        found = tally(name, out)
        other = sum(found.counts[kind.decode()] for kind in (WRONG, CRASHED, LATE))
        read, refused = (found.counts[kind.decode()] for kind in (READ, REFUSED))
        inputs = sum(found.counts.values())
        numbers = f"{inputs:9,}{read:9,}{refused:9,}{other:7,}{found.peak_bytes / 1e6:9.0f}{found.seconds:11.2f}"
        print(f"{name:18}{numbers}")
        for key, words in found.failures:
            print(f"    {key}: {words.strip().splitlines()[-1][:200]}")
        wrong, total = wrong + other, total + inputs
    print(f"{total:,} inputs, {wrong:,} neither read nor refused; target 0")
    return wrong


def main() -> int:
    """Run, and return 1 where an input was neither read nor refused."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=20_000, help="of all readers together")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--readers", nargs="*", choices=[*READERS], metavar="NAME", help=", ".join(READERS))
    parser.add_argument("--show", metavar="KEY")
    asked = parser.parse_args()
    if asked.show:
        show(asked.show)
        return 0
    names = asked.readers or [*READERS]
    with tempfile.TemporaryDirectory() as made:
        out = asked.out or Path(made)
        run(names, asked.inputs, asked.jobs, asked.seed, out)
        return int(table(names, out) > 0)


if __name__ == "__main__":
    sys.exit(main())
