"""Print how each joint of a robot answers its commands: lag, delay, bandwidth, gain, and whether that is known at all.

    python examples/g1_inspire_pick/report.py --dataset out/g1_pick --scene out/g1_scene/scene.yaml

No model of the robot is needed; `candata scene servo` writes the scene that names the joints.
"""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from servo_response import ServoResponse, servo_responses

from candata.datasets import open_dataset
from candata.gap.data.recordings import recordings
from candata.scenes import load_scene

#: Share of the movement foretold below which a lag and a gain are poor names for what a joint does.
POOR_R2 = 0.9
WORDS = (
    "moves  how far the command moves within an episode, 1 sd, in the joint's unit",
    "lag    how late the joint follows in all, with its 90 % interval; in rows of the recording beside it",
    "delay  the part of the lag in which nothing happens; the rest is slowness",
    "band   quickest motion that it still follows with half the power",
    "gain   how far it goes in the end, over how far it was told to go",
    "R2     share of the movement that lag and gain foretell in episodes they were not fitted to",
)


def table(found: Sequence[ServoResponse], rate_hz: float) -> list[str]:
    """Return the lines of the table: what answers, what a lag and a gain describe badly, what tells nothing."""
    seen, still = [f for f in found if f.identifiable], [f for f in found if not f.identifiable]
    names = max(len(f.joint) for f in found)
    lines = [f"{len(seen)} of {len(found)} joints move enough to tell how they answer their commands", ""]
    if seen:
        head = f"{'joint':{names}}{'moves':>8}{'lag, ms':>9}{'90 %':^14}{'rows':>6}{'delay, ms':>11}{'band, Hz':>10}"
        lines += [f"{head}{'gain':>7}{'R2':>7}", *(line(f, names, rate_hz) for f in seen), "", *WORDS]
    for why in dict.fromkeys(f.why_not for f in still):
        some = [f for f in still if f.why_not == why]
        most = max(f.motion for f in some)
        lines += ["", f"not identifiable, {why} ({most:.3f} at most):"]
        lines += textwrap.wrap(", ".join(f.joint for f in some), 100, initial_indent="  ", subsequent_indent="  ")
    return lines


def line(found: ServoResponse, names: int, rate_hz: float) -> str:
    """Return the line of one joint that answers; times in ms."""
    lag, low, high, delay = (1e3 * t for t in (found.lag_s, found.lag_low_s, found.lag_high_s, found.delay_s))
    late = f"{lag:9.0f}{f'{low:.0f} to {high:.0f}':^14}{found.lag_s * rate_hz:6.1f}{delay:11.0f}"
    poor = "  poor: something else decides" if found.r2 < POOR_R2 else ""
    size = f"{found.bandwidth_hz:10.2f}{found.gain:7.2f}{found.r2:7.3f}{poor}"
    return f"{found.joint:{names}}{found.motion:8.3f}{late}{size}"


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
    print("\n".join(table(found, scene.file.rate_hz)))


if __name__ == "__main__":
    main()
