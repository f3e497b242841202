"""LeRobot's own loader: LeRobotDataset with delta_timestamps in a torch DataLoader.

PYTHON benchmarks/others/lerobot_side.py FOLDER ROWS_AN_EPISODE HISTORY WINDOW BATCH
"""

from __future__ import annotations

import sys
import time

import torch
from answers import Places, serve
from torch.utils.data import DataLoader

KEYS = {
    "object_pose": "observation.object_pose",
    "joint_position": "observation.joint_position",
    "action": "action",
    "fingertip_force": "observation.fingertip_force",
    "fingertip_contact": "observation.fingertip_contact",
}


def main() -> None:
    """Open the set and answer."""
    torch.set_num_threads(1)
    begin = time.process_time()
    import lerobot
    from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata

    folder, (rows, history, window, batch) = sys.argv[1], map(int, sys.argv[2:])
    fps = LeRobotDatasetMetadata("local/benchmark", root=folder).fps
    steps = [(k - history + 1) / fps for k in range(window)]
    dataset = LeRobotDataset("local/benchmark", root=folder, delta_timestamps=dict.fromkeys(KEYS.values(), steps))

    def loaded(places: Places):
        numbers = [episode * rows + first + history - 1 for episode, first in places]
        for found in DataLoader(dataset, batch_size=batch, sampler=numbers):
            yield {name: found[key] for name, key in KEYS.items()}

    serve(f"lerobot {lerobot.__version__}", {"DataLoader": loaded}, time.process_time() - begin)


if __name__ == "__main__":
    main()
