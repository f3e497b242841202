"""Record a gripper of another physics engine (PyBullet) as if it were the real one, for MuJoCo to be diagnosed against.

    python examples/other_engine/record.py --hidden mass --out out/other_engine
    candata diagnose out/other_engine/recordings --scene out/other_engine/scene.yaml --out out/other_engine/report

Writes the nominal scene (`scene.xml`, `scene.yaml`) and the dataset `recordings`. The hidden change is not stored.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import bodies
import numpy as np
from numpy.typing import NDArray

from candata.datasets import append, create_dataset
from candata.errors import CandataError, MissingExtraError
from candata.policies import Plan, policy
from candata.scenes import Scene, load_scene
from candata.schema.contact import fingertip_contact
from candata.schema.episode import ContactRule, Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from candata.simulate.episodes import add_noise

MOTIONS = ("grasp_lift_shake", "push", "squeeze", "free_sweep")
#: What may be hidden: the names are this script's, the nominal scene knows none of it.
HIDDEN = {
    "none": {},
    "mass": {"mass_scale": 1.4},
    "friction": {"friction_scale": 0.6},
    "damping": {"damping_nms_rad": 0.02},  # at 0.05 the explicit steps are unstable
}


def write_scene(folder: Path) -> Scene:
    """Return the nominal scene, written to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.xml").write_text(bodies.mjcf())
    (folder / "scene.yaml").write_text(bodies.roles())
    return load_scene(folder / "scene.yaml")


def play(plan: Plan, scene: Scene, hidden: dict[str, float]) -> dict[str, NDArray]:
    """Return the channels of one plan played in the other engine, without noise."""
    from bullet import Hidden, World

    world = World(Hidden(**hidden))
    at = scene.object_qpos
    world.place(plan.qpos[scene.joint_qpos], plan.qpos[at : at + 7])
    force = np.zeros((len(bodies.TIPS), 3))
    for _ in range(round(plan.settle_s * bodies.RATE_HZ)):
        force = world.step(plan.commands[0])
    rows = []
    for command in plan.commands:
        rows.append((*world.read(), force))
        force = world.step(command)
    world.close()
    names = ("joint_position", "object_pose", "fingertip_force")
    return {name: np.stack(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)}


def record(scene: Scene, hidden: str, episodes: int, duration_s: float, seed: int) -> Iterator[Episode]:
    """Yield episodes of the other engine: candata's motions, with the sensor noise that the scene declares."""
    for i in range(episodes):
        task = MOTIONS[i % len(MOTIONS)]
        rng = np.random.default_rng([seed, i])
        plan = policy(task).plan(scene, rng, duration_s)
        arrays = add_noise(play(plan, scene, HIDDEN[hidden]), scene.file.noise, rng)
        count = len(plan.commands)
        arrays["action"] = plan.commands
        arrays["time_ns"] = np.round(np.arange(count) * 1e9 / bodies.RATE_HZ).astype(np.int64)
        arrays["fingertip_contact"] = fingertip_contact(arrays["fingertip_force"], ContactRule().threshold_n)
        arrays["contact"] = arrays["fingertip_contact"].any(1)
        print(f"episode {i + 1} of {episodes}: {task}", file=sys.stderr)
        yield Episode(_meta(scene, f"bullet-s{seed}-{i:04d}", task), arrays)


def _meta(scene: Scene, name: str, task: str) -> EpisodeMeta:
    """Return who, what, when; the recordings count as real."""
    file = scene.file
    return EpisodeMeta(
        id=name,
        source="real",
        rate_hz=bodies.RATE_HZ,
        object=file.object,
        task=task,
        joint_names=file.joints,
        actuator_names=file.actuator_names,
        fingertip_names=file.fingertips,
        contact_rule=ContactRule(),
    )


def main() -> None:
    """Write the scene and the recordings."""
    parser = argparse.ArgumentParser(description="Record a gripper simulated by PyBullet.")
    parser.add_argument("--hidden", choices=HIDDEN, default="none", help="what the nominal scene does not know")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--episodes", type=int, default=12)
    parser.add_argument("--duration-s", type=float, default=2.5)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    if asked.episodes < 1 or not 0.5 <= asked.duration_s <= 60 or asked.seed < 0:
        parser.error("give at least 1 episode of 0.5 to 60 s, and a seed from 0 on")
    try:
        import pybullet  # noqa: F401
    except ImportError:
        raise MissingExtraError("pybullet", "bench") from None
    scene = write_scene(asked.out)
    dataset = create_dataset(asked.out / "recordings")
    made = record(scene, asked.hidden, asked.episodes, asked.duration_s, asked.seed)
    append(dataset, made, Lineage(operation="record other engine", seeds=(asked.seed,)))
    print(f"{dataset}: {asked.episodes} episodes")


if __name__ == "__main__":
    try:
        main()
    except CandataError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
