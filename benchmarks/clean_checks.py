"""False alarms of every rule of `candata validate` over sound recordings.

    python benchmarks/clean_checks.py --episodes 2000 --jobs 2 --out out/clean_checks

N episodes of the built-in scenes (sets of 24: seeds, durations, motions, with and without noise) and N of random small
scenes played by plain MuJoCo (sets of 12, a scene each, every trait in turns) are validated, without and with their
scene. A finding of an episode counts once an episode, one of a set once a set. Targets: no error, warnings in at most
0.1 % of the episodes. A run that was stopped goes on when it is given the same --out. Exit 1 where a target is missed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from candata.checks import check, rule_names
from candata.datasets import append, create_dataset, open_dataset
from candata.gap.blind.rigs.cases import write_rig_case
from candata.gap.blind.rigs.design import all_traits
from candata.scenes import Scene, load_scene
from candata.scenes.roles import builtin_scenes
from candata.schema.bench import Label
from candata.schema.manifest import Lineage
from candata.simulate.crew import local
from candata.simulate.episodes import EpisodeJob, make_episodes

#: Episodes of a set: of a built-in scene, and of a random small one.
SETS = {"built-in": 24, "random small": 12}
#: Lengths of an episode of a built-in scene [s].
DURATIONS_S = (1.2, 2.0, 3.2, 5.0)
#: Target: warnings an episode, of all rules together.
WARNINGS = 0.001


class Alarm(NamedTuple):
    """A finding in a sound set: who raised it, how grave, in which episode ("" for the set), and its text."""

    rule: str
    level: str
    episode: str
    text: str


def validated(group: str, number: int, seed: int, log: Path) -> str:
    """Return a line on a set after its alarms were written to `log` as a line of JSON."""
    with TemporaryDirectory() as folder:
        scene = (_built_in if group == "built-in" else _random_small)(Path(folder) / "set", number, seed)
        data = open_dataset(Path(folder) / "set")
        alarms = {
            Alarm(f.rule, f.level, f.episode or "", f.message)
            for world in (None, scene)
            for f in check(data, scene=world)
            if f.level in ("error", "warning")
        }
        line = {
            "group": group,
            "set": number,
            "seed": seed,
            "scene": scene.name,
            "episodes": len(data),
            "alarms": sorted(alarms),
        }
    with log.open("a") as out:
        out.write(json.dumps(line) + "\n")
    return f"{group} {number} ({scene.name}): {len(alarms)} alarms"


def _built_in(path: Path, number: int, seed: int) -> Scene:
    """Return a built-in scene after a set of it was made."""
    rng = np.random.default_rng([seed, number])
    names = [entry.name for entry in builtin_scenes()]
    scene = load_scene(names[number % len(names)])
    motions = scene.policies if rng.random() < 0.6 else rng.choice(scene.policies, 1).tolist()
    numbers = range(SETS["built-in"])
    first = int(rng.integers(2**31))
    jobs = [EpisodeJob(id=f"e{i:02d}", index=i, policy=motions[i % len(motions)], seed=first) for i in numbers]
    noise = scene.file.noise if rng.random() < 0.75 else None
    made = make_episodes(scene, jobs, duration_s=float(rng.choice(DURATIONS_S)), noise=noise)
    create_dataset(path)
    append(path, made, Lineage(operation="benchmark"))
    return scene


def _random_small(path: Path, number: int, seed: int) -> Scene:
    """Return a random small scene after a set of it was recorded."""
    traits = ["plain", *all_traits()]
    label = Label(case="case-0001", kind="null", trait=traits[number % len(traits)], seed=seed * 10**6 + number)
    write_rig_case(path, label, "", SETS["random small"])
    return load_scene(path / "scene.yaml")


def table(lines: Sequence[dict]) -> tuple[list[str], bool]:
    """Return the rows of a run, one for each rule and one for all, and whether both targets are met."""
    out, met = [], True
    for group in SETS:
        sets = [line for line in lines if line["group"] == group]
        total = sum(line["episodes"] for line in sets)
        out += [f"{group}: {total} episodes in {len(sets)} sets", f"{'rule':<18}{'errors':>8}{'warnings':>10}{'%':>8}"]
        counts = np.array([[_count(sets, rule, level) for level in ("error", "warning")] for rule in rule_names()])
        for rule, (errors, warnings) in zip(
            (*rule_names(), "all"), (*counts.tolist(), counts.sum(0).tolist()), strict=True
        ):
            out.append(f"{rule:<18}{errors:>8}{warnings:>10}{100 * warnings / max(total, 1):>8.2f}")
        met &= not errors and warnings <= WARNINGS * total
    out.append(f"target: no error, warnings in at most {100 * WARNINGS:g} %: {'met' if met else 'MISSED'}")
    return out, met


def _count(sets: Sequence[dict], rule: str, level: str) -> int:
    """Return how many episodes a rule accuses, a finding of a whole set counted as one."""
    return len({(s["set"], a[2]) for s in sets for a in s["alarms"] if (a[0], a[1]) == (rule, level)})


def run(out: Path, episodes: int, seed: int, jobs: int) -> bool:
    out.mkdir(parents=True, exist_ok=True)
    log = out / "clean_checks.jsonl"
    done = {_key(line) for line in _read(log)}
    wanted = [(group, k, seed) for group, size in SETS.items() for k in range(-(-episodes // size))]
    # Both groups advance together: a run that is stopped says something of each.
    wanted.sort(key=lambda key: key[1] * SETS[key[0]])
    for text in local(jobs)(validated, [(*key, log) for key in wanted if key not in done]):
        print(f"  {text}", file=sys.stderr, flush=True)
    rows, met = table([line for line in _read(log) if _key(line) in wanted])
    print("\n".join(rows))
    return met


def _key(line: dict) -> tuple[str, int, int]:
    """Return which set a line is of."""
    return line["group"], line["set"], line["seed"]


def _read(log: Path) -> list[dict]:
    """Return the sets that were looked at; a line that was cut short is none."""
    whole = [text for text in log.read_text().splitlines(keepends=True) if text.endswith("\n")] if log.exists() else []
    log.write_text("".join(whole))
    return [json.loads(text) for text in whole]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=2000, help="of the built-in scenes, and of random small ones")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder of the run, which goes on there (default: a temporary one)")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        met = run(given.out or Path(folder), given.episodes, given.seed, given.jobs)
    sys.exit(not met)


if __name__ == "__main__":
    main()
