"""Lifts of objects by sampled grasps: in how many of a few tries the scripted grasp lifts each of a list of objects.

    python benchmarks/grasps.py --objects FILE [--scene xhand_tabletop] [--tries 8] [NAME ...]

Each object of the list (see `examples/paper/objects.yaml`; its folder is made by `candata fetch ycb`) is grasped,
carried and put down by `pick_and_place`, some tries in one batch. A try counts when the object is more than 5 cm above
its place for 1 s without a break. Printed are the lifts, how many ended within 5 cm of their place among those that
were not to be dropped, and the CPU time of the search for grasps. Without the folder nothing is measured.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from candata.errors import CandataError
from candata.policies import Plan, policy
from candata.policies._grasps import grasps
from candata.scenes import Scene, load_scene
from candata.schema.yaml_text import read_yaml
from candata.simulate import rollout

#: Targets: share of the tries that lift, on so many objects; CPU time of a search [s].
LEAST_SHARE, LEAST_OBJECTS, MOST_SEARCH_S = 0.6, 32, 3.0
#: What counts as lifted: height [m], time [s]. Length of a try [s].
LIFT_M, HELD_S, DURATION_S = 0.05, 1.0, 8.0
POLICY = "pick_and_place"


class Tries(NamedTuple):
    """What some tries of one object came to."""

    lifted: int
    placed: int
    to_place: int
    search_s: float


def tries(scene: Scene, count: int) -> Tries:
    """Return what `count` tries come to, seeds 0, 1, ... in one batch."""
    begin_s = time.process_time()
    grasps(scene)
    search_s = time.process_time() - begin_s
    plans = [policy(POLICY).plan(scene, np.random.default_rng(seed), DURATION_S) for seed in range(count)]
    places = _places(scene, plans)
    is_up = places[:, :, 2] - places[:, :1, 2] > LIFT_M
    held_rows = round(HELD_S * scene.file.rate_hz)
    is_lifted = [bool((np.convolve(row, np.ones(held_rows), "valid") == held_rows).any()) for row in is_up]
    goals = [plan.goal.place_m if plan.goal is not None else None for plan in plans]
    offs = [
        float(np.linalg.norm((place[-1] - place[0] - goal)[:2]))
        for place, goal in zip(places, goals, strict=True)
        if goal is not None
    ]
    return Tries(sum(is_lifted), int((np.array(offs) < 0.05).sum()), len(offs), search_s)


def _places(scene: Scene, plans: list[Plan]) -> np.ndarray:
    """Return where the object is `(n, T, 3)` [m] while the plans are played, after settling."""
    settle = round(plans[0].settle_s * scene.file.rate_hz)
    commands = np.stack([np.concatenate([np.repeat(p.commands[:1], settle, axis=0), p.commands]) for p in plans])
    starts = np.stack([p.qpos for p in plans]), np.stack([p.qvel for p in plans])
    played = rollout(scene, commands, *starts, [()] * len(plans), settle=settle)
    return played.readings["object_pose"][:, settle:, :3]


def main() -> int:
    """Run, and return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="some of the objects; all by default")
    parser.add_argument("--objects", type=Path, default=Path(__file__).parents[1] / "examples/paper/objects.yaml")
    parser.add_argument("--scene", default="xhand_tabletop")
    parser.add_argument("--tries", type=int, default=8)
    asked = parser.parse_args()
    listed = read_yaml(asked.objects)
    folder = asked.objects.parent / listed["folder"]
    if not folder.is_dir():
        print(f"no objects in {folder}: nothing measured")
        return 0
    names, good, slowest_s = asked.names or listed["objects"], 0, 0.0
    for name in names:
        try:
            of_object = tries(load_scene(f"{asked.scene}+{folder / name}"), asked.tries)
        except CandataError as error:
            print(f"{name:22s} no grasp: {error.found or error.problem}", flush=True)
            continue
        good += of_object.lifted >= LEAST_SHARE * asked.tries
        slowest_s = max(slowest_s, of_object.search_s)
        print(
            f"{name:22s} lifted {of_object.lifted} of {asked.tries}, put down {of_object.placed} of "
            f"{of_object.to_place}, search {of_object.search_s:.1f} s",
            flush=True,
        )
    print(f"{good} of {len(names)} objects lifted in {LEAST_SHARE:.0%} of the tries; slowest search {slowest_s:.1f} s")
    return int(good < LEAST_OBJECTS * len(names) / len(listed["objects"]) or slowest_s > MOST_SEARCH_S)


if __name__ == "__main__":
    sys.exit(main())
