"""Mistakes in recordings: which `candata validate --scene` finds, which it says it cannot tell, which pass in silence.

    python benchmarks/silent_mistakes.py --seed 1

Sound recordings of `gripper_tabletop`, `xhand_tabletop` and three random small scenes with two fingertips or more are
damaged by the injector, each mistake in all episodes, and validated with their scene. Each row is a mistake, each
column a scene. A cell holds level and rule of the gravest new finding, `unknown` where the mistake is listed as
undecidable, else SILENT. Targets: nothing silent; no error and no warning in the sound ones. Exit 1 on a
miss.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from candata.checks import Finding, check, defects
from candata.datasets import open_dataset
from candata.errors import DataError
from candata.gap.blind.rigs.cases import write_rig_case
from candata.gap.blind.rigs.recording import sane_rig
from candata.gap.blind.rigs.situations import TOUCHED
from candata.scenes import Scene, load_scene
from candata.schema.bench import Label
from candata.schema.episode import Episode
from candata.simulate.episodes import EpisodeJob, make_episodes

#: Episodes of a set, and their length [s] in built-in scenes.
EPISODES, DURATION_S = 12, 2.4
RANDOM = 3
#: Mistakes that only the scene tells, and what `unknown` calls them.
MISTAKES = {
    "tips_exchanged": "exchanged",
    "joints_exchanged": "joints exchanged",
    "commands_exchanged": "joints exchanged",
    "pairs_exchanged": "joints exchanged together with their commands",
    "tip_in_kilograms": "forces in another unit",
    "force_in_kilograms": "forces in another unit",
    "force_negated": "forces of the other sign",
    "force_turned": "axes of the forces in another order",
    "force_mirrored": "axes of the forces in another order",
    "force_rows_late": "forces that come late",
    "force_instant": "forces of one instant",
    "pose_rows_late": "poses that come late",
    "pose_lost": "poses at one value",
    "quaternion_conjugated": "conjugated quaternions",
    "world_mirrored": "a left-handed world, y axis reversed",
    "world_exchanged": "a left-handed world, axes x and y exchanged",
    "action_previous": "commands logged late",
}


class Sound(NamedTuple):
    """Sound recordings and the scene that made them."""

    name: str
    scene: Scene
    episodes: Sequence[Episode]


def built_in(name: str, seed: int) -> Sound:
    """Return recordings of a built-in scene, all of its motions in turns."""
    scene = load_scene(name)
    jobs = [EpisodeJob(f"e{i:02d}", i, scene.policies[i % len(scene.policies)], seed) for i in range(EPISODES)]
    return Sound(name, scene, make_episodes(scene, jobs, duration_s=DURATION_S, noise=scene.file.noise))


def random_small(folder: Path, seed: int) -> Sound:
    """Return recordings of a random small scene in which two fingertips or more have to do with an object.

    Joints and actuators are listed in one order, as the injector exchanges columns by their places.
    """
    rng = np.random.default_rng(seed)
    while True:
        drawn = int(rng.integers(2**40))
        rig = sane_rig(drawn, "plain", EPISODES).rig
        in_order = [f"m_{joint}" for joint in rig.file.joints] == list(rig.file.actuator_names)
        if rig.situation in TOUCHED and len(rig.file.fingertips) > 1 and len(rig.file.joints) > 1 and in_order:
            break
    path = folder / f"random-{seed}"
    write_rig_case(path, Label(case="case-0001", kind="null", trait="plain", seed=drawn), "", EPISODES)
    return Sound(f"{rig.situation}-{seed}", load_scene(path / "scene.yaml"), list(open_dataset(path).episodes()))


def validated(folder: Path, sound: Sound, mistake: str | None) -> tuple[Finding, ...]:
    """Return the findings of recordings with a mistake in all of them, contact derived as an import does."""
    rng = np.random.default_rng(0)
    raws = [defects.as_stored(e) if mistake is None else defects.with_defect(e, mistake, rng) for e in sound.episodes]
    root = defects.write(folder / f"{sound.name}-{mistake}", map(defects.with_derived_flags, raws))
    return check(open_dataset(root), scene=sound.scene)


def outcome(damaged: Sequence[Finding], sound: Sequence[Finding], name: str) -> str:
    """Return what the findings of damaged recordings say beside those of sound ones; `unknown` has a name for it."""
    known = {(f.level, f.rule, f.problem) for f in sound}
    candidates = [
        f for f in damaged if f.level in ("error", "warning") or (f.level == "info" and f.rule == "scene_match")
    ]
    new = [f for f in candidates if (f.level, f.rule, f.problem) not in known]
    if new:
        return f"{new[0].level}: {new[0].rule}"
    return "unknown" if any(f.level == "unknown" and name in f.message for f in damaged) else "SILENT"


def table(folder: Path, makers: Sequence[Callable[[], Sound]]) -> bool:
    """Print the outcome of each mistake in each scene, and return whether both targets are met."""
    met = True
    rows: dict[str, list[str]] = {name: [] for name in ("none", *MISTAKES)}
    names = []
    for maker in makers:
        sound = maker()
        names.append(sound.name)
        before = validated(folder, sound, None)
        alarms = [f for f in before if f.level in ("error", "warning")]
        rows["none"].append(f"{len(alarms)} alarms")
        met &= not alarms
        for mistake, name in MISTAKES.items():
            try:
                rows[mistake].append(outcome(validated(folder, sound, mistake), before, name))
            except DataError:
                rows[mistake].append("-")
            met &= rows[mistake][-1] != "SILENT"
        print(f"  {sound.name}", file=sys.stderr, flush=True)
    print(f"{'mistake':<24}" + "".join(f"{name:<22}" for name in names))
    for mistake, cells in rows.items():
        print(f"{mistake:<24}" + "".join(f"{cell:<22}" for cell in cells))
    print(f"target: nothing silent, no alarm without a mistake: {'met' if met else 'MISSED'}")
    return met


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scenes", default="gripper_tabletop,xhand_tabletop", help="built-in scenes")
    parser.add_argument("--random", type=int, default=RANDOM, help="random small scenes")
    given = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        makers: list[Callable[[], Sound]] = [
            *(lambda scene=scene: built_in(scene, given.seed) for scene in given.scenes.split(",") if scene),
            *(lambda k=k: random_small(folder, given.seed * 1000 + k) for k in range(given.random)),
        ]
        sys.exit(not table(folder, makers))


if __name__ == "__main__":
    main()
