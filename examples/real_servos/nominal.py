"""Print how far recorded joints go from the nominal scene under the recorded commands, open loop: rms by joint.

python examples/real_servos/nominal.py --dataset out/DS --scene examples/real_servos/xl330_pendulum/scene.yaml --by kp
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from candata.datasets import Dataset, open_dataset
from candata.gap.recordings import read
from candata.gap.starts import starts
from candata.scenes import Scene, load_scene
from candata.simulate import rollout


def lines(scene: Scene, dataset: Dataset, label: str | None) -> list[str]:
    """Return the table: a line for each joint and value of a label (of `EpisodeMeta.labels`)."""
    recs = read(scene, dataset)
    begin = starts(scene, recs)
    played = rollout(scene, recs.commands, begin.qpos0, begin.qvel0, [()] * len(recs), memory=begin.memory0)
    positions = recs.readings["joint_position"]
    error = positions - played.readings["joint_position"]
    motion = positions - np.nanmean(positions, axis=1, keepdims=True)
    values = np.array([_value(dataset, identity, label) for identity in recs.ids])
    out = [*recs.notes, f"{'joint':<14}{label or '':<12}{'episodes':>9}{'error, mrad':>13}{'motion, mrad':>14}"]
    for value in dict.fromkeys(values.tolist()):
        some = values == value
        for k, name in enumerate(scene.file.joints):
            sizes = [1e3 * float(np.sqrt(np.nanmean(x[some, :, k] ** 2))) for x in (error, motion)]
            out.append(f"{name:<14}{value:<12}{some.sum():>9}{sizes[0]:13.1f}{sizes[1]:14.1f}")
    return out


def _value(dataset: Dataset, identity: str, label: str | None) -> str:
    """Return what an episode says of a label."""
    return "" if label is None else str(dataset.episode(identity).meta.labels.get(label, "not stated"))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--by", metavar="LABEL", help="a line for each value of a label of the runs")
    given = parser.parse_args()
    print("\n".join(lines(load_scene(given.scene), open_dataset(given.dataset), given.by)))


if __name__ == "__main__":
    main()
