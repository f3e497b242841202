"""What filling a signature library costs and saves: a diagnosis with nothing kept, the filling, a diagnosis after it.

    python benchmarks/signatures.py --episodes 12 --only joint_damping,servo_gain,actuation_delay,object_mass

Printed: CPU s of a diagnosis with nothing kept and of one after the filling; CPU s, wall s and number of signatures of
each depth of filling, by one process and by --jobs; and from how many diagnoses on the filling of everything pays.
Targets: none is simulated after the filling, none twice, and processes share the work: at most a fifth more CPU than
one takes (each of them replays the nominal scene once).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from candata.datasets import append, create_dataset, open_dataset
from candata.gap import diagnose
from candata.gap.blind.signature_library import Source, keep_signature, planned, source
from candata.gap.screening.demand import Depth
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.schema.manifest import Lineage
from candata.simulate.crew import Crew, alone, local
from candata.simulate.episodes import EpisodeJob, make_episodes

SCENE = "xhand_tabletop"
TRUTH = (EffectSetting(name="joint_damping", parameters={"damping_Nms_rad": 0.03}),)
#: CPU of several processes over that of one.
SHARED = 1.2


class Cost(NamedTuple):
    """CPU and wall seconds, and how many signatures."""

    cpu_s: float
    wall_s: float
    count: int


def recorded(scene: Scene, folder: Path, episodes: int, duration_s: float) -> Path:
    """Return a dataset of the built-in hand with damped joints."""
    jobs = [
        EpisodeJob(f"e{i:03d}", i, scene.policies[i % len(scene.policies)], 1, TRUTH, hidden=True)
        for i in range(episodes)
    ]
    create_dataset(folder, "real")
    append(
        folder, make_episodes(scene, jobs, duration_s=duration_s, noise=scene.file.noise), Lineage(operation="bench")
    )
    return folder


def filled(some: Source, depth: Depth, crew: Crew) -> Cost:
    """Return what it takes to keep what is lacking; the floor, which every diagnosis shares, apart."""
    tasks = planned(some, depth).tasks
    begun = time.monotonic()
    spent = [one.cpu_s for one in crew(keep_signature, tasks)]
    return Cost(sum(spent), time.monotonic() - begun, len(spent))


def diagnosed(some: Source, scene: Scene) -> Cost:
    """Return what a diagnosis takes, and how many files it keeps that were not there."""
    before = len(list(Path(some.cache).rglob("*.npz")))
    cpu, begun = time.process_time(), time.monotonic()
    diagnose(open_dataset(some.dataset), scene, cache=Path(some.cache), only=some.only, shared_signatures=True)
    new = len(list(Path(some.cache).rglob("*.npz"))) - before
    return Cost(time.process_time() - cpu, time.monotonic() - begun, new)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=12)
    parser.add_argument("--duration-s", type=float, default=3.2)
    parser.add_argument("--only", default="joint_damping,servo_gain,actuation_delay,object_mass")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    scene = load_scene(SCENE)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        data = recorded(scene, root / "real", args.episodes, args.duration_s)

        def kept_in(name: str) -> Source:
            return source(data, SCENE, root / name)._replace(only=tuple(args.only.split(",")))

        cold = diagnosed(kept_in("cold"), scene)
        one = kept_in("one")
        steps = {depth: filled(one, depth, alone) for depth in ("first", "most", "all")}
        several = filled(kept_in("several"), "all", local(args.jobs))
        warm = diagnosed(one, scene)
    total = Cost(*(sum(values) for values in zip(*steps.values(), strict=True)))
    ratio = several.cpu_s / total.cpu_s
    found = [
        ("kept anew by a diagnosis after the filling", f"{warm.count}", "0", warm.count == 0),
        (f"CPU of {args.jobs} processes over one's", f"{ratio:.2f}", f"<= {SHARED:g}", ratio <= SHARED),
        (
            f"signatures simulated by {args.jobs} processes",
            f"{several.count}",
            f"{total.count}",
            several.count == total.count,
        ),
    ]
    for what, value, target, met in sorted(found, key=lambda row: row[3]):
        print(f"{'met   ' if met else 'MISSED'}  {what}: {value} (target {target})")
    print(f"diagnosis with nothing kept: {cold.cpu_s:.1f} CPU s, {cold.count} files; after it: {warm.cpu_s:.1f} CPU s")
    for depth, cost in steps.items():
        print(f"filling, {depth}: {cost.count} signatures more, {cost.cpu_s:.1f} CPU s, {cost.wall_s:.1f} s")
    print(f"filling, all, {args.jobs} processes: {several.cpu_s:.1f} CPU s, {several.wall_s:.1f} s")
    print(f"pays from about {max(1.0, total.cpu_s / max(cold.cpu_s - warm.cpu_s, 1e-9)):.0f} such diagnoses on")


if __name__ == "__main__":
    main()
