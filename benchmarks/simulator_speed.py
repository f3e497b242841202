"""The simulator as a forecaster beside bare stepping: physics steps a second of both, and their ratio.

Simulates episodes of `xhand_tabletop`, forecasts windows of them by `candata.training.simulator`, and steps MuJoCo
alone (`mj_step`, one simulation after another) from the same starts under the same commands, as many steps. The two
take turns, so that what else the machine does meets both.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from candata.loaders import Windows, windows
from candata.simulate.generate import generate
from candata.training.simulator import Simulator, simulator
from candata.training.window_starts import commands_from, window_starts

TARGET = 0.7


def bare_steps(forecaster: Simulator, batch: dict) -> tuple[int, float]:
    """Return the physics steps taken by MuJoCo alone, and the CPU seconds spent on them."""
    (scene,) = forecaster.scenes.scenes.values()
    start = window_starts(forecaster.windows, scene, batch)
    future_steps = (~batch["future_pad"]).sum(1)
    rows = start.lead + future_steps * forecaster.windows.stride[batch["episode"]]
    commands = commands_from(forecaster.windows, batch["episode"], start.first_row, int(rows.max()))
    data, taken, began_s = mujoco.MjData(scene.model), 0, time.process_time()
    for window, count in enumerate(rows.tolist()):
        mujoco.mj_resetData(scene.model, data)
        data.qpos[:], data.qvel[:] = start.qpos[window], start.qvel[window]
        for row in range(count):
            data.ctrl[scene.actuator_ids] = commands[window, row]
            mujoco.mj_step(scene.model, data, scene.substeps)
        taken += count * scene.substeps
    return taken, time.process_time() - began_s


def evenly(feed: Windows, count: int) -> Windows:
    """Return so many of the windows, evenly spread."""
    numbers = np.linspace(0, len(feed) - 1, count).round().astype(int)
    return replace(feed, present_row=feed.present_row[numbers], owner=feed.owner[numbers])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--windows", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        generate(Path(scratch) / "data", "xhand_tabletop", asked.episodes, 1, workers=1)
        channels = ("object_pose", "joint_position", "action")
        feed = evenly(windows(Path(scratch) / "data", channels=channels, pad="both"), asked.windows)
        forecaster = simulator(feed, None)
        batch = feed.batch(np.arange(len(feed)))
        ratios = []
        for _ in range(asked.rounds):
            bare, bare_s = bare_steps(forecaster, batch)
            began_s = time.process_time()
            forecaster.simulate(batch)
            spent_s = time.process_time() - began_s
            # The same steps are counted for both: what a batch takes for its longest window is the forecaster's loss.
            ratios.append(bare_s / spent_s)
            print(f"bare {bare / bare_s:,.0f} steps/s, forecaster {bare / spent_s:,.0f}, ratio {ratios[-1]:.2f}")
    print(f"ratio {np.median(ratios):.2f} (target {TARGET}): {len(feed) / spent_s:.1f} windows a CPU-second")


if __name__ == "__main__":
    main()
