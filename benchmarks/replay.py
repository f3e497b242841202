"""Replay throughput of the diagnosis as a share of bare `mujoco.rollout`: same scene, steps, commands and threads.

    python benchmarks/replay.py

Both sides step the same number of simulations from the same states with the same commands, one after the other in each
round, so that a busy machine slows both. The replay also follows the recording with the observer, reads the sensors,
averages forces and runs the effects' filters. Time is the process's CPU time.
"""

from __future__ import annotations

import argparse
import time

import mujoco
import numpy as np
from mujoco import rollout

from candata.effects import setting
from candata.gap.data.recordings import recordings
from candata.gap.replay.replayer import Replayer, replay
from candata.gap.replay.starts import starts
from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes

TARGET = 0.8


def bare(scene, commands: np.ndarray, qpos: np.ndarray, threads: int) -> float:
    """Return the CPU time of a bare rollout [s]."""
    control = np.repeat(commands, scene.substeps, axis=1)
    state = np.zeros((len(qpos), mujoco.mj_stateSize(scene.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    state[:, 1 : 1 + scene.model.nq] = qpos
    data = [mujoco.MjData(scene.model) for _ in range(max(1, threads))]
    with rollout.Rollout(nthread=threads if threads > 1 else 0) as pool:
        begin = time.process_time()
        pool.rollout(scene.model, data, state, control)
        return time.process_time() - begin


def main() -> None:
    """Print the ratio of each round and its median."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="xhand_tabletop")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--variants", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    scene = load_scene(args.scene)
    jobs = [EpisodeJob(f"e{i}", i, scene.policies[i % len(scene.policies)], 1) for i in range(args.episodes)]
    recs = recordings(scene, make_episodes(scene, jobs, duration_s=3.2, noise=scene.file.noise))
    begin = starts(scene, recs)
    delay = setting("actuation_delay", np.array([0.01]), scene)
    variants = [() if i % 2 else (delay,) for i in range(args.variants)]
    commands = np.concatenate([recs.commands] * args.variants)
    qpos = np.concatenate([begin.qpos] * args.variants)
    # A recording of T rows takes T - 1 control steps.
    steps = len(commands) * (commands.shape[1] - 1) * scene.substeps
    ratios = []
    for k in range(args.rounds):
        plain = bare(scene, commands[:, :-1], qpos, args.threads)
        start = time.process_time()
        replay(Replayer(scene, args.threads), recs, begin, variants)
        ours = time.process_time() - start
        ratios.append(plain / ours)
        print(f"round {k + 1}: bare {steps / plain:,.0f}, replay {steps / ours:,.0f} steps per CPU s: {ratios[-1]:.2f}")
    print(f"replay / mujoco.rollout: {np.median(ratios):.2f} (target >= {TARGET})")


if __name__ == "__main__":
    main()
