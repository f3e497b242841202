"""The `small` contact model after ten minutes, in closed loop on held-out episodes beside the plain baselines.

Simulates episodes of `xhand_tabletop`, runs `candata train` and `candata evaluate` as a user would, and prints the
closed-loop ADD-S AUC (mean of 16 samples) of the model, of the simulator, of "the object stays" and of "the object
keeps its velocity", the share of the time that training waited for data, and its windows a second.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

WAIT_TARGET = 0.01


def candata(*words: object) -> str:
    """Return what a command prints; its progress goes to the terminal."""
    command = [sys.executable, "-m", "candata_cli.main", *map(str, words)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--model", default="contact_diffusion")
    parser.add_argument("--learning-rate", type=float, default=3e-4)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder that keeps the data, the run and the page")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.keep or Path(scratch)
        data, run = folder / "data", folder / "run"
        candata(
            "generate-sim",
            "--scene",
            "xhand_tabletop",
            "--episodes",
            asked.episodes,
            "--seed",
            asked.seed,
            "--out",
            data,
        )
        candata(
            "train",
            "--data",
            data,
            "--model",
            asked.model,
            "--preset",
            "small",
            "--minutes",
            asked.minutes,
            "--learning-rate",
            asked.learning_rate,
            "--threads",
            asked.threads,
            "--out",
            run,
        )
        found = json.loads(candata("evaluate", run, data, "--threads", asked.threads, "--json"))
        log = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    steps = [line for line in log if "wait_share" in line]
    rate, wait = (statistics.median(line[key] for line in steps) for key in ("windows_per_s", "wait_share"))
    loops = {name: one["closed_loop"] for name, one in found["forecasters"].items()}
    print(f"{found['episodes']} held-out episodes, {asked.minutes:g} minutes, {steps[-1]['step']} steps")
    for name, loop in loops.items():
        near = loop["success"]
        print(
            f"{name}: closed-loop ADD-S AUC {100 * loop['adds_auc']:.1f} %, {near['count']}/{near['total']} within 5 cm"
        )
    for pair in (pair for pair in found["pairs"] if pair["forecaster"] == run.name):
        ends = [pair[key] for key in ("low", "high")]
        interval = "no interval" if None in ends else f"95 % {100 * ends[0]:+.1f} to {100 * ends[1]:+.1f}"
        target = ", target > 0" if pair["reference"] in ("stays", "keeps_velocity") else ""
        print(f"gain over {pair['reference']}: {100 * pair['value']:+.1f} points ({interval}){target}")
    print(f"{rate:,.0f} windows/s; waiting for data {100 * wait:.2f} % of the time, target <= {100 * WAIT_TARGET:g} %")


if __name__ == "__main__":
    main()
