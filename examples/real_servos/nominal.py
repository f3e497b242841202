"""Print how far recorded joints go from a scene under the recorded commands, open loop: rms by joint.

python examples/real_servos/nominal.py --dataset out/DS --scene examples/real_servos/xl330_pendulum/scene.yaml --by kp
python examples/real_servos/nominal.py --dataset out/DS --scene SCENE --effects out/report/calibration.yaml
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset, open_dataset
from candata.effects import read_effects
from candata.gap.data.recordings import Recordings, read
from candata.gap.replay.starts import starts
from candata.scenes import Scene, load_scene
from candata.simulate import rollout, with_effects

Array = NDArray[np.float64]


def lines(dataset: Dataset, scene: Scene, repaired: Scene | None, label: str | None) -> list[str]:
    """Return the table: a line for each joint and value of a label (of `EpisodeMeta.labels`), and for all joints.

    With a repaired scene a line also tells its error, and by how much less that is.
    """
    recs = read(scene, dataset)
    positions = recs.readings["joint_position"]
    sizes = [positions - _replayed(world, recs) for world in (scene, repaired) if world]
    sizes.append(positions - np.nanmean(positions, axis=1, keepdims=True))
    titles = ["error, mrad", *(["repaired", "less by"] if repaired else []), "motion, mrad"]
    values = np.array([_value(dataset, identity, label) for identity in recs.ids])
    out = [*recs.notes, f"{'joint':<14}{label or '':<12}{'episodes':>9}" + "".join(f"{t:>14}" for t in titles)]
    for value in dict.fromkeys(values.tolist()):
        chosen = values == value
        for k, name in [*enumerate(scene.file.joints), (slice(None), "all")]:
            rms = [1e3 * float(np.sqrt(np.nanmean(size[chosen][:, :, k] ** 2))) for size in sizes]
            columns = [f"{x:14.1f}" for x in rms]
            if repaired:
                columns.insert(2, f"{1 - rms[1] / rms[0]:14.0%}")
            out.append(f"{name:<14}{value:<12}{chosen.sum():>9}{''.join(columns)}")
    return out


def _replayed(scene: Scene, recs: Recordings) -> Array:
    """Return joint positions `(E, T, J)` under the recorded commands, open loop from the recorded start."""
    begin = starts(scene, recs)
    played = rollout(scene, recs.commands, begin.qpos0, begin.qvel0, [()] * len(recs), memory=begin.memory0)
    return played.readings["joint_position"]


def _value(dataset: Dataset, identity: str, label: str | None) -> str:
    """Return what an episode says of a label."""
    return "" if label is None else str(dataset.episode(identity).meta.labels.get(label, "not stated"))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--effects", type=Path, help="effects.yaml or calibration.yaml of a diagnosis of other runs")
    parser.add_argument("--by", metavar="LABEL", help="a line for each value of a label of the runs")
    asked = parser.parse_args()
    scene = load_scene(asked.scene)
    repaired = with_effects(scene, read_effects(asked.effects).effects) if asked.effects else None
    print("\n".join(lines(open_dataset(asked.dataset), scene, repaired, asked.by)))


if __name__ == "__main__":
    main()
