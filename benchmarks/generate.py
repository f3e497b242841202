"""Physics steps per CPU-second of `generate-sim`, without and with taxels, writing included, against bare `mj_step`.

All play the same commands in the same scene without effects and hold each command for the same number of
physics steps. They take turns in one run, so that a busy machine slows both. The CPU time of `generate-sim`
is that of the whole command with its children: start, import, compilation, simulation, noise, writing.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from candata.datasets import open_dataset
from candata.policies import policy
from candata.scenes import load_scene

#: Least share of the bare loop's speed, without and with taxels.
TARGET, TAXEL_TARGET = 0.7, 0.5


def cpu_s(who: int) -> float:
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def generate(scene: str, episodes: int, seed: int, jobs: int, taxels: bool, out: Path) -> float:
    """Return the CPU seconds of the command and its children."""
    before = cpu_s(resource.RUSAGE_CHILDREN)
    words = ["--scene", scene, "--episodes", str(episodes), "--seed", str(seed), "--jobs", str(jobs)]
    words += ["--taxels"] if taxels else []
    command = [sys.executable, "-m", "candata_cli.main", "generate-sim", *words, "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True)
    return cpu_s(resource.RUSAGE_CHILDREN) - before


def bare(name: str, seed: int, commands: list[np.ndarray]) -> tuple[float, int]:
    """Return CPU seconds and physics steps of a plain loop over the same commands, from the same starts."""
    scene = load_scene(name)
    rate, substeps, model = scene.file.rate_hz, scene.substeps, scene.model
    starts = []
    for index, played in enumerate(commands):
        motion = policy(scene.policies[index % len(scene.policies)])
        plan = motion.plan(scene, np.random.default_rng([seed, index, 0]), len(played) / rate)
        settle = np.repeat(plan.commands[:1], round(plan.settle_s * rate), axis=0)
        starts.append((plan.qpos, plan.qvel, np.concatenate([settle, plan.commands])))
    data, ids, steps = mujoco.MjData(model), scene.actuator_ids, 0
    before = cpu_s(resource.RUSAGE_SELF)
    for qpos, qvel, rows in starts:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        for row in rows[:-1]:
            data.ctrl[ids] = row
            for _ in range(substeps):
                mujoco.mj_step(model, data)
        steps += (len(rows) - 1) * substeps
    return cpu_s(resource.RUSAGE_SELF) - before, steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="xhand_tabletop")
    parser.add_argument("--episodes", type=int, default=192)
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    ways = [(1, False), (2, False), (1, True)]
    ratios: dict[tuple[int, bool], list[float]] = {way: [] for way in ways}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(asked.rounds):
            whole_s = {
                (jobs, taxels): generate(
                    asked.scene, asked.episodes, seed, jobs, taxels, Path(folder) / f"{seed}-{jobs}-{taxels}"
                )
                for jobs, taxels in ways
            }
            episodes = open_dataset(Path(folder) / f"{seed}-1-False")
            commands = [e.arrays.get("action", np.zeros((len(e), 0))) for e in episodes]
            loop_s, steps = bare(asked.scene, seed, commands)
            print(f"round {seed}: bare mj_step {steps / loop_s:,.0f} steps/CPU-s", end="")
            for way, used_s in whole_s.items():
                ratios[way].append(loop_s / used_s)
                print(f"; {label(*way)} {steps / used_s:,.0f}, ratio {ratios[way][-1]:.2f}", end="")
            print()
    for (jobs, taxels), values in ratios.items():
        print(
            f"generate-sim / bare mj_step, {asked.scene}, {asked.episodes} episodes, {label(jobs, taxels)}: "
            f"median {statistics.median(values):.2f}, target >= {TAXEL_TARGET if taxels else TARGET}"
        )


def label(jobs: int, taxels: bool) -> str:
    """Return how a set was made, in words."""
    return f"{jobs} process(es)" + (" with taxels" if taxels else "")


if __name__ == "__main__":
    main()
