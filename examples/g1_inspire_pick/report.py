"""Print how each joint of a robot answers its commands: lag, delay, bandwidth, gain, and whether that is known at all.

    python examples/g1_inspire_pick/report.py --dataset out/g1_pick --scene out/g1_scene/scene.yaml

No model of the robot is needed; `candata scene servo` writes the scene that names the joints.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from candata.datasets import open_dataset
from candata.gap.recordings import recordings
from candata.gap.servo_response import ServoResponse, servo_responses
from candata.scenes import load_scene


def line(found: ServoResponse, rate_hz: float) -> str:
    """Return the line of one joint; numbers of a joint that tells nothing are left out."""
    head = f"{found.joint:24}{found.motion:8.4f}"
    if not found.identifiable:
        return f"{head}  not identifiable: {found.why_not}"
    lag = f"{found.lag_s:7.3f} [{found.lag_low_s:.3f} {found.lag_high_s:.3f}] {found.lag_s * rate_hz:5.1f}"
    return f"{head}{lag}{found.delay_s:8.3f}{found.bandwidth_hz:10.2f}{found.gain:7.2f}{found.r2:8.3f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0, help="of folds and resamples")
    parser.add_argument("--json", action="store_true", help="print JSON, with the numbers of all joints")
    given = parser.parse_args()
    scene = load_scene(given.scene)
    recs = recordings(scene, open_dataset(given.dataset).episodes())
    found = servo_responses(scene, recs, np.random.default_rng(given.seed))
    if given.json:
        print(json.dumps([asdict(f) | {"identifiable": f.identifiable} for f in found], indent=1))
        return
    units = f"{'delay, s':>9}{'band, Hz':>9}{'gain':>7}{'R2':>8}"
    print(f"{'joint':24}{'moves':>8}{'lag, s':>7} {'90 %':15}{'rows':>5}{units}")
    for one in found:
        print(line(one, scene.file.rate_hz))


if __name__ == "__main__":
    main()
