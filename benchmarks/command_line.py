"""What `candata --help` costs beside the least that any command line of its kind costs, in one run.

    python benchmarks/command_line.py [--rounds N]

CPU time of whole processes, in turns, so that a busy machine slows all alike: an interpreter that does nothing, one
that loads typer, and `candata --help`. The median of the rounds counts.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys

#: CPU seconds that `--help` may take (docs/decisions/0020-files-and-commands.md).
TARGET_S = 0.3
#: What is run, as the arguments of an interpreter.
RUNS = {
    "python": ["-c", "pass"],
    "python, typer loaded": ["-c", "import typer"],
    "candata --help": ["-m", "candata_cli.main", "--help"],
}


def cpu_s(arguments: list[str]) -> float:
    """Return the CPU seconds of an interpreter with these arguments."""
    before = os.times()
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])


def main() -> None:
    """Measure in turns and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15, help="times that each is run")
    rounds = parser.parse_args().rounds
    taken: dict[str, list[float]] = {name: [] for name in RUNS}
    for _ in range(rounds):
        for name, arguments in RUNS.items():
            taken[name].append(cpu_s(arguments))
    least = statistics.median(taken["python, typer loaded"])
    print(f"{'':26s}{'CPU s':>8s}{'ratio':>8s}")
    for name, seconds in taken.items():
        median = statistics.median(seconds)
        print(f"{name:26s}{median:8.2f}{median / least:8.2f}")
    met = statistics.median(taken["candata --help"]) < TARGET_S
    print(f"candata --help under {TARGET_S} s: {'met' if met else 'MISSED'}")


if __name__ == "__main__":
    main()
